"""Edits in Blender on a million splats: times, and blocking of the main thread.

    python tools/measure/edits.py [--capture CAPTURE] [--splats N] [--part PART] [--triangles N]
                                  [--group] [--text]                    (a Python with bpy)

Splats of SH degree 3 are on spheres, like surfaces of captures, with some floaters. Each operator
runs in short steps as in a window. Prints, for two calls of each: total seconds; CPU milliseconds
of the longest step of the main thread, without those of Blender itself (entering Edit Mode; the
scene is evaluated before), and those of Blender; and the largest delay of the main thread's wake-up
in milliseconds, caused by threads that hold Python's lock or by other programs, as in *Nothing*.

*Separate* removes half of the splats, *Join* adds as many, rotated, *Update Shapes and Colors*
follows Blender's Apply, *Decimate* keeps half, and compares pictures from the capture's cameras.
*Compare with Photo* uses a camera of the capture.

The part `light`, of larger and opaque splats: *World from Splats* and *Match Sun* at their
defaults, *Relight Splats* without and with a proxy, *Erase* of a pole of a sphere, *Heal* there,
*Update Proxy* of that, and *Replay Edits* of both on the splats before.
"""

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import bpy
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from gscore.shared_constants import SH_C0  # noqa: E402 - the path comes first
from tools.measure.windowless import steps, windowless  # noqa: E402 - the path comes first

SPHERES, RADII = 5, (1.0, 0.5, 0.3)
FLOATING = 200
"""One of this many splats is a floater."""


def parse() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--capture", type=Path, default=ROOT / "examples" / "studio")
    parser.add_argument("--splats", type=int, default=1_000_000)
    parser.add_argument("--part", choices=("all", "edits", "light"), default="all")
    parser.add_argument("--triangles", type=int, default=200_000, help="of the proxy")
    parser.add_argument("--group", action="store_true", help="put all into a vertex group")
    parser.add_argument("--text", action="store_true", help="add a text attribute")
    return parser.parse_args()


def surfaces(count: int) -> dict[str, np.ndarray]:
    """The arrays of `Splats`: flat splats on spheres side by side."""
    rng = np.random.default_rng(0)

    def noise(*shape: int) -> np.ndarray:
        return rng.standard_normal((count, *shape), np.float32)

    ahead = noise(3)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    means = ahead * rng.choice(np.float32(RADII), count)[:, None]
    means[:, 0] += 1.2 * rng.integers(SPHERES, size=count)
    means[::FLOATING] *= 3
    flat = np.float32([-5.2, -5.2, -7.5])
    return {
        "means": means,
        "quats": noise(4),
        "scales": noise(3) * 0.5 + flat,
        "opacities": noise(),
        "sh0": noise(1, 3),
        "shN": noise(15, 3) * 0.1,
    }


class Blenders:
    """CPU seconds of calls into Blender."""

    def __init__(self) -> None:
        self.spent = 0.0

    def timed(self, call: Callable[..., Any]) -> Callable[..., Any]:
        """Wrap a call and add up its time."""

        def timed(*args: Any, **options: Any) -> Any:
            began = time.thread_time()
            try:
                return call(*args, **options)
            finally:
                self.spent += time.thread_time() - began

        return timed


def carry(ob: bpy.types.Object, *, group: bool, text: bool) -> None:
    """Add the requested vertex group and attribute."""
    from addon.splats import vertex_groups
    from addon.splats.point_attributes import Column, blocks

    count = len(ob.data.vertices)
    if group:
        values = np.linspace(0.25, 0.75, count, dtype=np.float32)[:, None]
        for name, _, entries in blocks(Column("group", "GROUP", values)):
            vertex_groups.write(ob.data, name, entries)
    if text:
        ob.data.attributes.new("text", "STRING", "POINT")
        words = np.array([b"text"] * count, np.object_)[:, None]
        for name, _, entries in blocks(Column("text", "STRING", words)):
            for at, entry in enumerate(entries):
                ob.data.attributes[name].data[at].value = entry


def timed(name: str, operator: str, **settings: Any) -> None:
    """Print the times of an operator call from Object Mode, and return there."""
    bpy.context.view_layer.update()
    bpy.ops.ed.undo_push(message=name)
    measured(name, windowless(operator, **settings).steps(bpy.context))
    if bpy.context.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")


def measured(name: str, task: Any) -> None:
    """Run a task and print its times."""
    from addon.process.incremental_tasks import TaskRunner
    from addon.splats import edit_operators, operators, select_operators

    blenders, enter = Blenders(), operators.edit_vertices
    for module in (edit_operators, select_operators):
        module.edit_vertices = blenders.timed(enter)
    own, theirs, late = 0.0, 0.0, 0.0
    began = time.perf_counter()
    try:
        going = TaskRunner(task)
        for step, waited in steps(going):
            own, theirs = max(own, step - blenders.spent), max(theirs, blenders.spent)
            late, blenders.spent = max(late, waited), 0.0
    finally:
        for module in (edit_operators, select_operators):
            module.edit_vertices = enter
    took = time.perf_counter() - began
    print(
        f"{name:30} {took:6.2f} s {own * 1e3:6.0f} ms {theirs * 1e3:6.0f} ms {late * 1e3:6.0f} ms",
        flush=True,
    )


def nothing() -> Iterator[str]:
    """Empty steps, for the delay of the main thread itself."""
    for _ in range(100):
        yield ""


def stroke(task: Any) -> Iterator[str]:
    """A whole stroke of a brush, a move per step."""
    made = yield from task
    for x in range(500, 1100, 20):
        made.to(np.array([x, 450.0]))
        made.show()
        yield ""
    yield from made.finish()


def strokes(ob: bpy.types.Object, camera: bpy.types.Object) -> None:
    """Measure the start of a brush stroke, a whole one, and picking a color."""
    from addon.cameras.render_camera import render_camera
    from addon.paint import paint_target, visible_splats
    from addon.paint.brush import Brush

    scene = bpy.context.scene
    view = render_camera(camera, scene, width=1600, height=900)
    brush = Brush(radius=50, color=(1, 0, 0))
    measured("Paint", paint_target.begin_stroke(ob, brush, view))
    measured("Paint, Front Only", paint_target.begin_stroke(ob, brush, view, front_only=True))
    measured("Paint, a Stroke", stroke(paint_target.begin_stroke(ob, brush, view)))
    with suppress(ValueError):  # there may be no splat in the middle
        measured("Paint, Pick a Color", visible_splats.color_at(ob, view, np.array([800.0, 450.0])))


def edits(ob: bpy.types.Object, camera: bpy.types.Object) -> None:
    """Measure selections, edits, comparisons and strokes."""
    from addon import attributes
    from addon.splats import objects

    scene, count = bpy.context.scene, len(ob.data.vertices)
    numbers = np.arange(count)
    timed("Compare with Photo", "compare_photo", camera=camera.name)
    timed("Compare with Photo, again", "compare_photo", camera=camera.name)
    strokes(ob, camera)
    attributes.select(ob.data, numbers == 1)
    timed("Color", "select_by_color")
    attributes.select(ob.data, numbers == 1)
    timed("Flood", "select_flood")
    timed("Floaters", "select_floaters")
    timed("Opacity", "select_by_opacity")
    timed("Size", "select_by_size", high=0.01)
    timed("Hidden", "select_splats", which="HIDDEN")
    timed("Grade", "grade_splats", saturation=0.5)
    attributes.select(ob.data, numbers % 2 == 0)
    timed("Separate", "separate_splats")
    part = next(o for o in scene.objects if objects.is_splats(o) and o is not ob)
    part.rotation_euler = (0.1, 0.2, 0.3)
    for one in (part, ob):
        one.select_set(True)
    timed("Join", "join_splats")
    ob.rotation_euler = (0.1, 0.2, 0.3)
    timed("Apply Splat Transform", "apply_splat_transform")
    ob.rotation_euler = (0.1, 0.2, 0.3)
    bpy.ops.object.select_all(action="DESELECT")
    ob.select_set(True)
    bpy.ops.object.transform_apply()
    timed("Update Shapes and Colors", "mend_splats")
    timed("Decimate", "decimate_splats", count=count // 2)
    ob.gscore.opacity_min = 0.5
    timed("Delete Hidden Splats", "apply_filters")


def lit(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The arrays with a sun, splats within ten degrees of a direction that are bright; all are
    opaque, and so large that spheres have no gaps."""
    larger = np.float32(np.log(2e3 / len(arrays["means"]) ** 0.5))
    towards = arrays["means"] / np.linalg.norm(arrays["means"], axis=1, keepdims=True)
    sun = towards @ np.float32([0.6, 0.0, 0.8]) > np.cos(np.radians(10))
    colors = np.where(sun[:, None, None], np.float32(1.5 / SH_C0), arrays["sh0"] * 0.3)
    changed = {"scales": arrays["scales"] + larger, "opacities": arrays["opacities"] + 3}
    return {**arrays, "sh0": colors, **changed}


def ball(radius: float, x: float, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and triangles of a sphere of 2 x `rows` columns."""
    turn, tilt = np.meshgrid(
        np.linspace(0, 2 * np.pi, 2 * rows + 1)[:-1], np.linspace(0.01, np.pi - 0.01, rows + 1)
    )
    places = np.stack([np.cos(turn) * np.sin(tilt), np.sin(turn) * np.sin(tilt), np.cos(tilt)], -1)
    at = np.arange(turn.size).reshape(turn.shape)
    right = np.roll(at, -1, axis=1)
    quads = np.stack([at[:-1], at[1:], right[1:], right[:-1]], -1).reshape(-1, 4)
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return radius * places.reshape(-1, 3) + [x, 0, 0], triangles


def add_proxy(ob: bpy.types.Object, triangles: int) -> None:
    """Give the splats of `surfaces` a proxy as *Make Proxy* does, and measure the last step."""
    from addon.core import SurfaceMesh
    from addon.render.proxy import MADE, attach
    from addon.surface import fit_proxy
    from addon.surface.mesh_object import filled

    rows = round((triangles / (4 * SPHERES * len(RADII))) ** 0.5)
    parts = [ball(radius, 1.2 * number, rows) for number in range(SPHERES) for radius in RADII]
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts[:-1])])
    vertices = np.concatenate([vertices for vertices, _ in parts])
    faces = [made + start for (_, made), start in zip(parts, starts, strict=True)]
    surface = SurfaceMesh(
        vertices=vertices,
        triangles=np.concatenate(faces),
        colors=np.full((len(vertices), 3), 0.5, np.float32),
    )
    proxy = bpy.data.objects.new("proxy", filled(surface, None, "proxy"))
    ob.users_collection[0].objects.link(proxy)
    proxy[MADE] = True
    attach(bpy.context.scene, ob, proxy)
    measured("Make Proxy, its end", fit_proxy.note(ob, proxy))


def light(ob: bpy.types.Object, triangles: int) -> None:
    """Measure the light of splats, and the edits that new splats get too."""
    from addon import attributes
    from addon.splats import objects

    scene = bpy.context.scene
    before = ob.copy()
    before.data = ob.data.copy()
    scene.collection.objects.link(before)
    before.hide_viewport = True
    timed("World from Splats", "world_from_splats")
    timed("Match Sun", "match_sun")
    timed("Relight Splats", "relight_splats")
    add_proxy(ob, triangles)
    timed("Relight Splats, Proxy", "relight_splats")
    timed("the same, As in the Scene", "relight_splats", captured="SCENE")
    places = attributes.column(ob.data, attributes.POSITION)
    attributes.select(ob.data, np.linalg.norm(places - [1.2, 0, 1], axis=1) < 0.3)
    timed("Erase", "erase_splats")
    timed("Heal", "heal_splats")
    timed("Update Proxy", "update_proxy")
    before.hide_viewport = False
    bpy.context.view_layer.update()
    for one in (ob, before):
        one.select_set(True)
    bpy.context.view_layer.objects.active = before
    timed("Replay Edits", "replay_edits")
    suns = [one for one in scene.objects if one.type == "LIGHT"]
    for one in (*suns, objects.proxy_of(ob), before):
        bpy.data.objects.remove(one)


def main() -> None:
    """Measure and print."""
    options = parse()
    import addon
    from addon.cameras.objects import is_camera, root_of
    from addon.core import Splats
    from addon.splats import objects

    def create(arrays: dict[str, np.ndarray]) -> bpy.types.Object:
        ob = objects.create(Splats(**arrays), "splats", collection=scene.collection)
        ob.parent = root_of(camera)
        carry(ob, group=options.group, text=options.text)
        bpy.context.view_layer.objects.active = ob
        return ob

    addon.register()
    try:
        bpy.ops.wm.read_homefile(use_empty=True)
        scene = bpy.context.scene
        bpy.ops.gscore.import_cameras(directory=str(options.capture.resolve()))
        camera = next(filter(is_camera, scene.objects))
        arrays = surfaces(options.splats)
        print(f"{'':30} {'whole':>8} {'ours':>9} {'Blender':>9} {'late':>9}")
        for _ in range(2):
            measured("Nothing", nothing())
            if options.part != "light":
                ob = create(arrays)
                edits(ob, camera)
                bpy.data.objects.remove(ob)
            if options.part != "edits":
                ob = create(lit(arrays))
                light(ob, options.triangles)
                bpy.data.objects.remove(ob)
    finally:
        addon.unregister()
        sys.stdout.flush()


if __name__ == "__main__":
    main()
