"""Make a capture with exact truth: a yard, a room, a village or a showroom, by Cycles.

python examples/make_place.py yard -o out/yard --gains smooth

Needs gscore and the Python package bpy (4.5 or later). Writes pictures, exact cameras and depths,
and points as structure from motion finds them: sampled from the depths, observed in three pictures
or more with half a pixel of noise. Seeds are fixed. `truth.json` has the light and the gains of the
pictures in stops.
"""

import argparse
import json
import logging
from pathlib import Path

import bpy
import numpy as np
from studio_maker import cameras, places, render

from gscore.frontend import ColmapCamera, ColmapImage, ColmapModel, rotmat_to_quat, write_colmap
from gscore.io.colmap.model import ColmapPoints
from gscore.io.images.png import write_png

log = logging.getLogger("make_place")


def main():
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("place", choices=places.PLACES)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder to write")
    parser.add_argument("--size", type=int, nargs=2, default=(480, 320), metavar=("W", "H"))
    parser.add_argument("--views", type=int, default=48)
    parser.add_argument("--samples", type=int, default=24, help="maximum samples per pixel")
    parser.add_argument("--light", choices=("a", "b"), default="a", help="of two lights")
    parser.add_argument("--threads", type=int, default=0, help="threads of Cycles; 0: one per core")
    parser.add_argument(
        "--gains",
        choices=tuple(GAINS),
        default="none",
        help="exposure of the pictures: equal, changing smoothly or in jumps over 1.5 stops, or "
        "bracketed by two stops",
    )
    args = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    width, height = args.size
    bpy.ops.wm.read_factory_settings(use_empty=True)
    place = places.PLACES[args.place](args.views, args.light, np.random.default_rng(5))
    stops = GAINS[args.gains](args.views, np.random.default_rng(6))
    focal = place.focal * width
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    camera = cameras.add_camera()
    camera.data.clip_end = 1000
    render.configure(width, height, args.samples, args.threads)
    names = [f"view_{i:03d}.png" for i in range(args.views)]
    (args.output / "images").mkdir(parents=True, exist_ok=True)
    (args.output / "depths").mkdir(exist_ok=True)
    pictures, depths = [], []
    for name, viewmat, stop in zip(names, place.viewmats, stops, strict=True):
        cameras.place(camera, K, viewmat, width)
        rgb, _, depth = render.picture(args.output / ".render", gain=2.0**stop)
        pictures.append(np.round(rgb * 255).astype(np.uint8))
        depths.append(depth)
        write_png(args.output / "images" / name, pictures[-1])
        np.save(args.output / "depths" / f"{name}.npy", depth.astype(np.float32))
        log.info("%s", name)
    write_colmap(model(names, K, place.viewmats, pictures, depths), args.output / "sparse" / "0")
    truth = {"light": args.light, "stops": dict(zip(names, stops.tolist(), strict=True))}
    (args.output / "truth.json").write_text(json.dumps(truth, indent=1) + "\n")


GAINS = {
    "none": lambda views, _: np.zeros(views),
    "smooth": lambda views, _: 0.75 * np.sin(np.linspace(0, 4 * np.pi, views)),
    "jumps": lambda views, rng: rng.uniform(-0.75, 0.75, views),
    "brackets": lambda views, _: np.resize([-2.0, 0.0, 2.0], views),
}
"""Functions of the number of pictures and a generator, to stops [views]."""


def model(names, K, viewmats, pictures, depths, count=8000, noise=0.5):
    """The capture as COLMAP finds it, without error of cameras.

    Args:
        names: of the pictures; K: [3, 3]; viewmats: [C, 4, 4].
        pictures: [H, W, 3] uint8 each; depths: [H, W] along the optical axis, inf: none.
        count: number of sampled points; noise: of observations, pixels.
    """
    rng = np.random.default_rng(7)
    height, width = depths[0].shape
    points, colors = [], []
    for viewmat, picture, depth in zip(viewmats, pictures, depths, strict=True):
        each = count // len(names)
        y, x = rng.integers(0, height, each), rng.integers(0, width, each)
        z = depth[y, x]
        x, y, z = x[np.isfinite(z)], y[np.isfinite(z)], z[np.isfinite(z)]
        rays = np.stack([x + 0.5, y + 0.5, np.ones(len(x))], -1) @ np.linalg.inv(K).T
        points.append((rays * z[:, None] - viewmat[:3, 3]) @ viewmat[:3, :3])
        colors.append(picture[y, x])
    xyz, rgb = np.concatenate(points), np.concatenate(colors)
    shown = np.stack([visible(xyz, K, v, d) for v, d in zip(viewmats, depths, strict=True)])
    keep = shown.sum(0) >= 3
    xyz, rgb, shown = xyz[keep], rgb[keep], shown[:, keep]
    images = []
    for i, (name, viewmat) in enumerate(zip(names, viewmats, strict=True)):
        rows = np.flatnonzero(shown[i])
        image = (xyz[rows] @ viewmat[:3, :3].T + viewmat[:3, 3]) @ K.T
        xys = image[:, :2] / image[:, 2:] + rng.normal(0, noise, (len(rows), 2))
        images.append(
            ColmapImage(
                id=i + 1, name=name, camera_id=1, qvec=rotmat_to_quat(viewmat[:3, :3]),
                tvec=viewmat[:3, 3].copy(), xys=xys, point3D_ids=rows.astype(np.int64) + 1,
            )
        )  # fmt: skip
    params = np.array([K[0, 0], K[1, 1], K[0, 2], K[1, 2]])
    camera = ColmapCamera(model="PINHOLE", width=width, height=height, params=params)
    error = np.full(len(xyz), noise)
    found = ColmapPoints(
        ids=np.arange(1, len(xyz) + 1), xyz=xyz + rng.normal(0, 0.002, xyz.shape), rgb=rgb,
        error=error, track_lengths=shown.sum(0).astype(np.int32),
    )  # fmt: skip
    return ColmapModel(cameras={1: camera}, images=images, points=found)


def visible(xyz, K, viewmat, depth):
    """[P] bool: points of the world [P, 3] that a picture shows, by its exact depth [H, W]."""
    p = xyz @ viewmat[:3, :3].T + viewmat[:3, 3]
    z = np.maximum(p[:, 2], 1e-6)
    x, y = (np.floor(p[:, i] / z * K[i, i] + K[i, 2]).astype(int) for i in (0, 1))
    height, width = depth.shape
    inside = (p[:, 2] > 0.1) & (x >= 0) & (y >= 0) & (x < width) & (y < height)
    seen = depth[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)]
    return inside & (np.abs(seen - z) < 0.01 * z)


if __name__ == "__main__":
    main()
