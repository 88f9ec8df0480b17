"""Light of splats on a grey ball beside the truth: one exposure, and brackets.

python tools/measure/world_light.py WORK

Renders a room with its lamps in view once, with colors that are not limited, makes captures of one
exposure and of brackets, and a true panorama; trains a draft of each; makes World from Splats and
prints the difference of a grey ball under it and under the truth. Run it with the Python that has
bpy; GSCORE_TRAINER_PYTHON trains.
"""

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

import bpy
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "examples")]

from make_place import model  # noqa: E402
from studio_maker import cameras, places, render  # noqa: E402

from gscore.frontend import write_colmap  # noqa: E402
from gscore.io.exposure_json import read_exposures  # noqa: E402
from gscore.io.images.png import write_png  # noqa: E402
from gscore.shared_constants import EXPOSURE_POWER  # noqa: E402

EXPOSURES = {"one": [0.0], "brackets": [-2.0, 0.0, 2.0], "dark": [-5.0, -2.5, 0.0]}
"""Stops, which photos have in turn. Lamps are clipped in all photos of `one` and `brackets`."""
PLACE = (0.2, -0.3, 1.3)
"""Where the ball is."""
ALBEDO = 0.5


def looks(views: int) -> np.ndarray:
    """Cameras [C, 4, 4] on a ring in the room, that see walls, floor and ceiling in turn."""
    turn = np.linspace(0, 2 * np.pi, views, endpoint=False)
    eyes = np.stack([1.4 * np.cos(turn), 1.1 * np.sin(turn), 1.3 + 0.3 * np.sin(5 * turn)], -1)
    yaw, pitch = turn + np.pi + 0.9 * np.sin(2 * turn), np.resize([-0.5, -0.1, 0.3, 0.7], views)
    level = np.cos(pitch)
    aims = eyes + np.stack([level * np.cos(yaw), level * np.sin(yaw), np.sin(pitch)], -1)
    return np.stack([cameras.look_at(*pair) for pair in zip(eyes, aims, strict=True)])


def render_room(work: Path, views: int, size: tuple[int, int], samples: int, threads: int) -> None:
    """Write the linear pictures, their depths and cameras, and the true panorama."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    places.PLACES["room"](views, "a", np.random.default_rng(5))
    camera = cameras.add_camera()
    render.configure(*size, samples, threads)
    K = np.array([[0.55 * size[0], 0, size[0] / 2], [0, 0.55 * size[0], size[1] / 2], [0, 0, 1]])
    viewmats, pictures, depths = looks(views), [], []
    for viewmat in viewmats:
        cameras.place(camera, K, viewmat, size[0])
        rgb, _, depth = render.linear_picture(work / ".render")
        pictures.append(rgb.astype(np.float32))
        depths.append(depth.astype(np.float32))
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = 512, 256
    camera.location = PLACE
    camera.rotation_mode, camera.rotation_euler = "XYZ", (np.pi / 2, 0, -np.pi / 2)  # +X ahead
    camera.data.type = "PANO"
    camera.data.panorama_type = "EQUIRECTANGULAR"
    panorama = render.linear_picture(work / ".render")[0]
    with (work / ".room").open("wb") as file:
        np.savez(file, K=K, viewmats=viewmats, pictures=pictures, depths=depths, truth=panorama)
    (work / ".room").rename(work / "room.npz")


def write_capture(folder: Path, room: dict[str, np.ndarray], stops: list[float]) -> None:
    """Write photos with these exposures in turn, and points as COLMAP finds them."""
    (folder / "images").mkdir(parents=True)
    names = [f"view_{i:03d}.png" for i in range(len(room["pictures"]))]
    stops = np.resize(stops, len(names)).tolist()
    photos = [
        np.round(255 * render.exposed(rgb, 2.0**stop)).astype(np.uint8)
        for rgb, stop in zip(room["pictures"], stops, strict=True)
    ]
    for name, photo in zip(names, photos, strict=True):
        write_png(folder / "images" / name, photo)
    made = model(names, room["K"], room["viewmats"], photos, room["depths"])
    write_colmap(made, folder / "sparse" / "0")
    (folder / "truth.json").write_text(json.dumps(dict(zip(names, stops, strict=True))))


def train(capture: Path, run: Path) -> None:
    """Train a draft."""
    line = [os.environ["GSCORE_TRAINER_PYTHON"], "-m", "gscore", "train", str(capture)]
    subprocess.run(
        [*line, "-o", str(run), "--preset", "draft", "--no-eval", "--overwrite"],
        check=True,
        cwd=ROOT,
    )


def world_of(run: Path, capture: Path) -> np.ndarray:
    """The panorama [256, 512, 3] that World from Splats makes, brought to the exposure 0."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.gscore.import_splats(filepath=str(run / "point_cloud.ply"), turn_views=False)
    bpy.context.object.matrix_world.identity()
    bpy.context.scene.cursor.location = PLACE
    bpy.ops.gscore.world_from_splats(width=512)
    image = next(i for i in bpy.data.images if i.name.endswith("Light"))
    pixels = np.array(image.pixels[:], np.float32).reshape(256, 512, 4)[::-1, :, :3]
    truth, exposures = json.loads((capture / "truth.json").read_text()), read_exposures(run)
    mean = np.mean(list(truth.values()))  # gains are 1 on average
    stops = [EXPOSURE_POWER * np.log2(one.gain).mean() for one in exposures.values()]
    error = np.array(stops) - [truth[name] - mean for name in exposures]
    print(
        f"{run.name}: gains off by {np.abs(error).mean():.2f} stops, {np.abs(error).max():.2f} max"
    )
    return pixels * 2.0**-mean


def ball(panorama: np.ndarray, side: int = 96) -> np.ndarray:
    """A diffuse ball under a panorama [H, W, 3]: sRGB [side, side, 3] from the front, back, above
    and below, one beside the other; NaN around it. Exact for a convex body in distant light."""
    height, width = panorama.shape[:2]
    polar = (np.arange(height) + 0.5) / height * np.pi
    turn = np.pi - (np.arange(width) + 0.5) / width * 2 * np.pi  # +X in the middle, +Y to its left
    level = np.sin(polar)[:, None]
    towards = np.stack(
        [level * np.cos(turn), level * np.sin(turn), np.cos(polar)[:, None] + 0 * turn], -1
    )
    light = panorama * (level * np.pi / height * 2 * np.pi / width)[..., None]
    blocks = (height // 4, 4, width // 4, 4, 3)  # 3 degrees, little for a diffuse ball
    towards = towards.reshape(blocks).mean((1, 3)).reshape(-1, 3)
    light = light.reshape(blocks).sum((1, 3)).reshape(-1, 3)
    y, x = (np.mgrid[:side, :side] + 0.5) / side * 2 - 1
    inside = x**2 + y**2 < 1
    facing = np.sqrt(1 - (x**2 + y**2)[inside])
    out = []
    for ahead, right, up in (
        ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
        ((-1, 0, 0), (0, -1, 0), (0, 0, 1)),
        ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
        ((0, 0, -1), (0, 1, 0), (1, 0, 0)),
    ):
        normal = np.stack([facing, x[inside], -y[inside]], -1) @ np.array([ahead, right, up], float)
        cosine = np.maximum(normal @ towards.T, 0)
        picture = np.full((side, side, 3), np.nan)
        picture[inside] = render.exposed(ALBEDO / np.pi * (cosine @ light))
        out.append(picture)
    return np.concatenate(out, 1)


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("work", type=Path, help="folder for photos and runs")
    parser.add_argument("--views", type=int, default=48)
    parser.add_argument("--size", type=int, nargs=2, default=(320, 240), metavar=("W", "H"))
    parser.add_argument("--samples", type=int, default=24)
    parser.add_argument("--threads", type=int, default=0, help="threads of Cycles; 0: one per core")
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    if not (args.work / "room.npz").is_file():
        render_room(args.work, args.views, tuple(args.size), args.samples, args.threads)
    room = dict(np.load(args.work / "room.npz"))
    import addon

    addon.register()
    truth = ball(room["truth"])
    rows = [shown(room["truth"], truth)]
    for name, stops in EXPOSURES.items():
        capture, run = args.work / name, args.work / f"{name}-run"
        if not capture.is_dir():
            write_capture(capture, room, stops)
        if not (run / "point_cloud.ply").is_file():
            train(capture, run)
        world = world_of(run, capture)
        rows.append(shown(world, lit := ball(world)))
        error = 255 * np.abs(lit - truth)
        print(f"{name}: ball off by {np.nanmean(error):.1f} of 255, {np.nanmax(error):.0f} max;")
        print(f"    brightest {world.max():.1f}, in truth {room['truth'].max():.1f}")
    write_png(args.work / "light.png", np.concatenate(rows))


def shown(world: np.ndarray, balls: np.ndarray) -> np.ndarray:
    """A world, the same four stops darker, and balls under it: bytes [96, 656, 3]."""
    small = world.reshape(64, 4, 128, 4, 3).mean((1, 3))
    row = np.zeros((96, 256 + 384 + 16, 3))
    row[16:80, :128], row[16:80, 128:256] = render.exposed(small), render.exposed(small, 1 / 16)
    row[:, 272:] = np.nan_to_num(balls)
    return np.round(255 * row).astype(np.uint8)


if __name__ == "__main__":
    main()
