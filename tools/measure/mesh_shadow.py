"""Shadow of a mesh on splats, by the engine and by Cycles: Suzanne on the studio's rug.

python tools/measure/mesh_shadow.py WORK [--truth] [--light 0] [--lamps NAME ...] [--worlds ...]

Trains a draft of the studio in WORK/run and makes its proxy, WORK/run/surface.ply, where they are
missing. Relights the splats, *As in the Scene* with the studio's lamps, and renders them with
Suzanne's shadow twice: by the engine (F12), and as a composite, whose shadow on the proxy is by
Cycles. No camera sees Suzanne, and pixels that she would cover do not count. Prints a Markdown
table of the mean difference, levels of 255, over the pixels that she darkens in the composite by
more than 5 in the mean of the channels; over those of them within 12 px of her; and over all of
them without her, which is how exact the comparison is. WORK/*.png are the engine's picture, the
composite and four times their difference, with Suzanne in grey.

--truth compares engine and composite with a composite whose proxy is the true scene, as Cycles
knows it, in the proxy's colors; and, where Suzanne stands in the figure's shadow, composites
over the pixels of her that the true scene darkens by more than 5. The proxy has no backdrop, and
the true scene only with --backdrop. WORK/truth*.ply are made where they are missing, in minutes.
Run it with the Python that has bpy; GSCORE_TRAINER_PYTHON trains.
"""

import argparse
import itertools
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector
from mathutils.kdtree import KDTree

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "examples")]

from studio_maker import blender, cameras, figure, stage  # noqa: E402

import addon  # noqa: E402
from addon.core import read_splats, read_surface  # noqa: E402
from addon.render.proxy import attach  # noqa: E402
from addon.splats import objects  # noqa: E402
from addon.surface.mesh_object import filled  # noqa: E402
from gscore.io.images.png import write_png  # noqa: E402
from gscore.mesh.surface_mesh import SurfaceMesh, write_surface  # noqa: E402

PROXY = "proxy"
"""Name of the proxy."""
AREAS, SUN = "four area lamps", "sun"
"""The studio's own lamps, or a sun in their place."""
WORLDS = {"studio": (0.35, 0.36, 0.38), "nearly black": (0.002, 0.002, 0.002)}
"""Linear colors of the world."""
TOWARDS_SUN = (0.45, 0.35, 1.0)
"""Vector to the sun: 60 degrees above the floor, over the backdrop."""
EYE, AIM, PLACE = (0.9, -2.45, 2.05), (0.4, -0.5, 0.1), (0.55, -0.5)
"""Camera, the middle of its picture, and Suzanne, metres."""
SHADED = (-0.45, -0.35)
"""Place in the shadow of the figure under the sun, metres."""
RUG = 0.013
"""Height of the rug, metres."""
DARKER, NEAR = 5, 12
"""Levels of 255 above which darkening is a shadow, and pixels around Suzanne that are near her."""
WITHOUT_NOISE = 4
"""Samples of Cycles without Suzanne: both renders of its shadow pass are then the same."""


@dataclass(frozen=True)
class Figures:
    """Differences of a case, of 255."""

    pixels: int
    """Number of pixels in the shadow."""
    darkening: float
    """Mean darkening of the composite there."""
    shadow: float
    """Mean difference there."""
    near: float
    """Mean difference near Suzanne."""
    without: float
    """Mean difference in the shadow's pixels without Suzanne."""

    def row(self, lamps: str, world: str) -> str:
        """A row of the table."""
        cells = [lamps, world, f"{self.pixels:,}"]
        values = self.darkening, self.shadow, self.near, self.without
        return f"| {' | '.join([*cells, *(f'{value:.1f}' for value in values)])} |"


def train(capture: Path, run: Path) -> None:
    """Train a draft and make its mesh, where they are missing."""
    line = [os.environ.get("GSCORE_TRAINER_PYTHON", sys.executable), "-m", "gscore"]
    if not (run / "point_cloud.ply").is_file():
        how = ["--preset", "draft", "--mask-mode", "none", "--no-eval"]
        subprocess.run([*line, "train", str(capture), "-o", str(run), *how], check=True, cwd=ROOT)
    if not (run / "surface.ply").is_file():
        made = ["mesh", str(run), "-o", str(run / "surface.ply"), "--triangles", "200000"]
        subprocess.run([*line, *made], check=True, cwd=ROOT)


def make_truth(path: Path, surface: SurfaceMesh, *, backdrop: bool) -> None:
    """Write the surface of the studio, with or without its backdrop, as Cycles knows it, in the
    colors of another mesh of it, where it is missing: also if that mesh is another one now."""
    if path.is_file():
        return
    bpy.ops.wm.read_factory_settings(use_empty=True)
    stage.build(np.random.default_rng(1))
    figure.build(np.random.default_rng(2), coarse=False)
    if not backdrop:
        bpy.data.objects.remove(bpy.data.objects["backdrop"])
    vertices, triangles = blender.figure_surface(with_stage=True)
    tree = KDTree(len(surface.vertices))
    for i, place in enumerate(surface.vertices):
        tree.insert(place, i)
    tree.balance()
    colors = surface.colors[[tree.find(place)[1] for place in vertices]]
    write_surface(path, SurfaceMesh(vertices=vertices, triangles=triangles, colors=colors))


def configure(size: tuple[int, int], threads: int) -> None:
    """Set up renders of an empty scene."""
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.resolution_percentage = 100
    if threads:
        scene.render.threads_mode, scene.render.threads = "FIXED", threads
    scene.render.dither_intensity = 0.0
    scene.view_settings.view_transform = "Standard"
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode = "RGBA"
    scene.cycles.use_adaptive_sampling, scene.cycles.use_denoising = False, True
    scene.cycles.denoiser = "OPENIMAGEDENOISE"


def look(size: tuple[int, int]) -> None:
    """Add the camera."""
    focal = 1.2 * size[0]
    K = np.array([[focal, 0, size[0] / 2], [0, focal, size[1] / 2], [0, 0, 1]])
    camera = cameras.add_camera()
    cameras.place(camera, K, cameras.look_at(np.array(EYE), np.array(AIM)), size[0])
    camera.data.clip_start = 0.01


def import_run(run: Path, surface: Path) -> bpy.types.Object:
    """The splats with their proxy, relit with the light of the studio."""
    scene = bpy.context.scene
    splats = objects.create(
        read_splats(run / "point_cloud.ply"), "splats", collection=scene.collection
    )
    proxy = bpy.data.objects.new(PROXY, filled(read_surface(surface), None, PROXY))
    scene.collection.objects.link(proxy)
    attach(scene, splats, proxy)
    bpy.context.view_layer.objects.active = splats
    splats.select_set(True)
    bpy.context.view_layer.update()
    assert bpy.ops.gscore.relight_splats(captured="SCENE") == {"FINISHED"}
    return splats


def add_suzanne(size: float) -> bpy.types.Object:
    """Suzanne with smooth sides, who stands on the rug."""
    bpy.ops.mesh.primitive_monkey_add(size=size, location=(*PLACE, 0))
    head = bpy.context.object
    head.name = "Suzanne"
    smooth = head.modifiers.new("smooth", "SUBSURF")
    smooth.levels = smooth.render_levels = 2
    bpy.ops.object.shade_smooth()
    shape = head.evaluated_get(bpy.context.evaluated_depsgraph_get())
    head.location.z = RUG - min(vertex.co.z for vertex in shape.data.vertices)
    return head


def remove_lamps() -> None:
    """Remove all lamps."""
    for ob in [ob for ob in bpy.context.scene.objects if ob.type == "LIGHT"]:
        bpy.data.lights.remove(ob.data)


def add_sun(energy: float, angle: float) -> None:
    """Add a sun of an angle, degrees."""
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.energy, sun.data.angle = energy, np.radians(angle)
    sun.rotation_euler = (-Vector(TOWARDS_SUN)).to_track_quat("-Z", "Y").to_euler()
    bpy.context.scene.collection.objects.link(sun)


def set_light(lamps: str, world: str, energy: float, angle: float) -> None:
    """Set the scene's lamps and world in place of those before."""
    remove_lamps()
    stage.add_lights()
    if lamps == SUN:
        remove_lamps()
        add_sun(energy, angle)
    nodes = bpy.context.scene.world.node_tree.nodes
    nodes["Background"].inputs[0].default_value = (*WORLDS[world], 1)
    bpy.context.view_layer.update()


def picture(engine: str, *, compositing: bool = False) -> np.ndarray:
    """Render the scene: RGBA [H, W, 4], sRGB, the top row first."""
    scene = bpy.context.scene
    scene.render.engine, scene.render.use_compositing = engine, compositing
    path = Path(bpy.app.tempdir) / "shadow.png"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path), check_existing=False)
    width, height = image.size
    values = np.array(image.pixels[:], np.float32).reshape(height, width, 4)[::-1]
    bpy.data.images.remove(image)
    return values


def pair(samples: int) -> tuple[np.ndarray, np.ndarray]:
    """The pictures of the engine and of the composite [H, W, 3]."""
    return picture("GSCORE_SPLATS")[..., :3], composite(samples)


def composite(samples: int) -> np.ndarray:
    """The picture of the composite [H, W, 3]."""
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.samples = "CYCLES", samples
    assert bpy.ops.gscore.set_up_compositing() == {"FINISHED"}
    return picture("CYCLES", compositing=True)[..., :3]


def alone(splats: bpy.types.Object, samples: int) -> np.ndarray:
    """Suzanne without splats and their proxy, RGBA [H, W, 4]."""
    scene = bpy.context.scene
    scene.cycles.samples = samples
    scene.render.film_transparent = splats.hide_render = True
    found = picture("CYCLES")
    scene.render.film_transparent = splats.hide_render = False
    return found


def grown(mask: np.ndarray, radius: int) -> np.ndarray:
    """A mask and what is within a radius of it, px; it must not reach the border."""
    found, steps = mask.copy(), range(-radius, radius + 1)
    for dy, dx in ((y, x) for y in steps for x in steps if x * x + y * y <= radius**2):
        found |= np.roll(mask, (dy, dx), (0, 1))
    return found


def measure(head: bpy.types.Object, covered: np.ndarray, samples: int, file: Path) -> Figures:
    """The figures of the scene's light, and a picture of them."""
    engine, truth = pair(samples)
    head.hide_render = True
    without, truth_without = pair(WITHOUT_NOISE)
    head.hide_render = False
    darker = 255 * (truth_without - truth).mean(axis=2)
    shadow = (darker > DARKER) & ~covered
    difference = 255 * np.abs(engine - truth).mean(axis=2)
    show(file, [engine, truth, np.minimum(4 * np.abs(engine - truth), 1)], covered)
    return Figures(
        pixels=int(shadow.sum()),
        darkening=float(darker[shadow].mean()),
        shadow=float(difference[shadow].mean()),
        near=float(difference[shadow & grown(covered, NEAR)].mean()),
        without=255 * float(np.abs(without - truth_without)[shadow].mean()),
    )


def measure_truth(
    head: bpy.types.Object,
    splats: bpy.types.Object,
    truth: bpy.types.Mesh,
    samples: int,
    file: Path,
) -> str:
    """Cells of the row beside the true scene, and a picture of both shadows."""
    proxy = bpy.data.objects[PROXY]
    own, place = proxy.data, head.location.copy()
    head.visible_camera = True
    covered = alone(splats, 1)[..., 3] > 0
    head.visible_camera = False
    by_engine, by_proxy = pair(samples)
    proxy.data = truth
    by_truth = composite(samples)
    head.hide_render = True
    darker = 255 * (composite(WITHOUT_NOISE) - by_truth).mean(axis=2)
    head.hide_render, head.visible_camera = False, True
    head.location.xy = SHADED
    lit = alone(splats, samples)
    her_truth = composite(samples)
    proxy.data = own
    her_proxy = composite(samples)
    head.location, head.visible_camera = place, False
    darker_her = 255 * (lit[..., :3] - her_truth).mean(axis=2)
    cells = difference_cells(darker, ~covered, [by_engine, by_proxy], by_truth)
    cells += difference_cells(darker_her, lit[..., 3] >= 1, [her_proxy], her_truth)
    show(file, [by_engine, by_proxy, by_truth], covered)
    nothing = np.zeros_like(covered)
    show(file.with_stem(f"{file.stem}-her"), [lit[..., :3], her_proxy, her_truth], nothing)
    return " | ".join(cells)


def difference_cells(
    darker: np.ndarray, where: np.ndarray, pictures: list[np.ndarray], truth: np.ndarray
) -> list[str]:
    """Number of pixels that the true shadow darkens [H, W], by how much, and the differences of
    pictures there."""
    shadow = (darker > DARKER) & where
    found = [255 * float(np.abs(one - truth).mean(axis=2)[shadow].mean()) for one in pictures]
    values = [float(darker[shadow].mean()), *found]
    return [f"{shadow.sum():,}", *(f"{value:.1f}" for value in values)]


def show(file: Path, pictures: list[np.ndarray], covered: np.ndarray) -> None:
    """Write pictures beside each other, Suzanne in grey."""
    shown = [np.where(covered[..., None], 0.5, one) for one in pictures]
    write_png(file, np.round(255 * np.concatenate(shown, axis=1)).astype(np.uint8))


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("work", type=Path, help="folder for run and pictures")
    parser.add_argument("--capture", type=Path, default=ROOT / "examples" / "studio")
    parser.add_argument("--surface", type=Path, help="proxy; by default WORK/run/surface.ply")
    parser.add_argument("--lamps", nargs="+", choices=[AREAS, SUN], default=[AREAS, SUN])
    parser.add_argument("--worlds", nargs="+", choices=[*WORLDS], default=[*WORLDS])
    parser.add_argument("--truth", action="store_true", help="compare with the true scene")
    parser.add_argument("--backdrop", action="store_true", help="keep that of the true scene")
    parser.add_argument("--light", type=float, default=1.0, help="0: captured look; 1: relit")
    parser.add_argument("--energy", type=float, default=5.0, help="strength of the sun")
    parser.add_argument("--angle", type=float, default=5.0, help="angle of the sun, degrees")
    parser.add_argument("--suzanne", type=float, default=0.4, help="size of Suzanne, metres")
    parser.add_argument("--size", type=int, nargs=2, default=(320, 240), metavar=("W", "H"))
    parser.add_argument("--samples", type=int, default=128, help="samples of Cycles")
    parser.add_argument("--threads", type=int, default=0, help="threads of Cycles; 0: one per core")
    args = parser.parse_args()
    run = args.work / "run"
    surface = args.surface or run / "surface.ply"
    train(args.capture, run)
    truth_file = args.work / f"truth{'-backdrop' * args.backdrop}.ply"
    if args.truth:
        make_truth(truth_file, read_surface(surface), backdrop=args.backdrop)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    addon.register()
    configure(tuple(args.size), args.threads)
    look(args.size)
    set_light(AREAS, "studio", args.energy, args.angle)
    splats = import_run(run, surface)
    splats.gscore.light = args.light
    head = add_suzanne(args.suzanne)
    if args.truth:
        truth = filled(read_surface(truth_file), None, "truth")
        print("| lamps | world | pixels | by | engine | composite | of her | by | composite |")
        print("|---|---|---|---|---|---|---|---|---|", flush=True)
    else:
        covered = alone(splats, 1)[..., 3] > 0
        head.visible_camera = False
        print("| lamps | world | pixels | darkened by | differ by | near Suzanne | without her |")
        print("|---|---|---|---|---|---|---|", flush=True)
    for lamps, world in itertools.product(args.lamps, args.worlds):
        set_light(lamps, world, args.energy, args.angle)
        file = args.work / f"{lamps} {world}{' truth' * args.truth}.png".replace(" ", "-")
        if args.truth:
            row = measure_truth(head, splats, truth, args.samples, file)
            print(f"| {lamps} | {world} | {row} |", flush=True)
        else:
            print(measure(head, covered, args.samples, file).row(lamps, world), flush=True)


if __name__ == "__main__":
    main()
