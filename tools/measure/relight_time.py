"""Time of F12 of relit splats after a lamp has moved, over that of the splats as captured.

python tools/measure/relight_time.py RUN [--surface FILE] [--pairs N] [--scenes NAME ...]

Renders the splats of a training at 1280 x 720 px through one of its cameras, in pairs in one
process: with the light of the photos, and lit by the scene after a lamp has moved. Prints medians
of the ratios, of elapsed time and of processor time (for machines that do other work too).
Run it with the Python that has bpy.
"""

import argparse
import json
import sys
import time
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

import addon
from addon.core import Splats, quat_to_rotmat, read_splats, read_surface
from addon.render.proxy import attach
from addon.splats import objects
from addon.surface.mesh_object import filled

SIZE = 1280, 720
SCENES = {
    "sun, no proxy": ["SUN"],
    "sun": ["SUN"],
    "point": ["POINT"],
    "area": ["AREA"],
    "four": ["POINT", "SUN", "SPOT", "POINT"],
    "sun, mesh": ["SUN"],
    "area, mesh": ["AREA"],
}
"""Kinds of the lamps; the first moves. A mesh, which hides the world too, stands still."""


def resized(splats: Splats, count: int) -> Splats:
    """As many splats: each split along its longest axis until there are enough, then a sample."""
    while len(splats) < count:
        axis = np.argmax(splats.scales, axis=1)
        rows = np.arange(len(splats))
        step = quat_to_rotmat(splats.quats)[rows, :, axis] * np.exp(splats.scales[rows, axis, None])
        scales = splats.scales.copy()
        scales[rows, axis] -= np.float32(np.log(1.6))
        rest = {name: getattr(splats, name) for name in ("quats", "opacities", "sh0", "shN")}
        means = [(splats.means + sign * step / 2).astype(np.float32) for sign in (1, -1)]
        splats = Splats(
            means=np.concatenate(means),
            scales=np.concatenate([scales, scales]),
            **{name: np.concatenate([values, values]) for name, values in rest.items()},
        )
    rng = np.random.default_rng(0)
    return splats.subset(np.sort(rng.choice(len(splats), count, replace=False)))


def look(scene: bpy.types.Scene, cameras: Path) -> None:
    """A camera at the place of the first one of a training, wider."""
    from mathutils import Matrix

    first = json.loads(cameras.read_text())[0]
    matrix = np.eye(4)
    matrix[:3, :3] = np.array(first["rotation"]) * [1, -1, -1]
    matrix[:3, 3] = first["position"]
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(camera)
    camera.matrix_world, scene.camera = Matrix(matrix), camera
    camera.data.angle = 2 * np.arctan(first["width"] / 2 / first["fx"]) * SIZE[0] / SIZE[1]
    camera.data.clip_start = 0.01
    scene.render.resolution_x, scene.render.resolution_y = SIZE


def place_lamps(scene: bpy.types.Scene, kinds: list[str], middle: np.ndarray, radius: float):
    """The lamps above the splats, the first one returned."""
    made = []
    for number, kind in enumerate(kinds):
        data = bpy.data.lights.new(kind, kind)
        ob = bpy.data.objects.new(kind, data)
        scene.collection.objects.link(ob)
        turn = 1.0 + 1.6 * number
        ob.location = middle + 0.5 * radius * np.array([np.cos(turn), np.sin(turn), 0.8])
        ob.rotation_euler = (0.4, 0.3, turn)
        data.energy = 3.0 if kind == "SUN" else 40 * radius**2
        if kind == "AREA":
            data.size = 0.2 * radius
        made.append(ob)
    return made


def timed(act: Callable[[], object]) -> tuple[float, float]:
    """Elapsed and processor seconds."""
    began, used = time.perf_counter(), time.process_time()
    act()
    return time.perf_counter() - began, time.process_time() - used


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("run", type=Path, help="folder of a training")
    parser.add_argument("--surface", type=Path, help="proxy; by default RUN/surface.ply")
    parser.add_argument("--splats", type=int, default=300_000, help="number of splats")
    parser.add_argument("--pairs", type=int, default=7)
    parser.add_argument("--scenes", nargs="+", choices=[*SCENES], default=[*SCENES])
    args = parser.parse_args(sys.argv[1:])
    bpy.ops.wm.read_factory_settings(use_empty=True)
    addon.register()
    scene = bpy.context.scene
    scene.render.engine = "GSCORE_SPLATS"
    scene.world = bpy.data.worlds.new("world")
    splats = resized(read_splats(args.run / "point_cloud.ply"), args.splats)
    ob = objects.create(splats, "splats", collection=scene.collection)
    low, high = np.percentile(splats.means, [5, 95], axis=0)
    middle, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    look(scene, args.run / "cameras.json")
    bpy.context.view_layer.objects.active = ob
    ob.select_set(True)
    assert bpy.ops.gscore.relight_splats() == {"FINISHED"}
    surface = read_surface(args.surface or args.run / "surface.ply")
    print(f"{args.splats:,} splats, {SIZE[0]} x {SIZE[1]} px, proxy of {len(surface.triangles):,}")
    proxy = None
    for name in args.scenes:
        if name != "sun, no proxy" and proxy is None:
            proxy = bpy.data.objects.new("proxy", filled(surface, None, "proxy"))
            scene.collection.objects.link(proxy)
            attach(scene, ob, proxy)
        if name.endswith("mesh"):
            bpy.ops.mesh.primitive_monkey_add(size=0.5 * radius, location=middle)
        lamps = place_lamps(scene, SCENES[name], middle, radius)
        rows = []
        for number in range(args.pairs + 1):
            lamps[0].rotation_euler[1] += 0.02
            lamps[0].location[0] += 0.01 * radius
            taken = []
            for ob.gscore.light in (0.0, 1.0) if number % 2 else (1.0, 0.0):
                taken.append(timed(bpy.ops.render.render))
            rows.append(taken if number % 2 else taken[::-1])
        (plain, lit), (plain_cpu, lit_cpu) = np.array(rows[1:]).transpose(2, 1, 0)
        for what, one, other in ("elapsed", lit, plain), ("processors", lit_cpu, plain_cpu):
            ratio, *times = np.median([one / other, 1000 * one, 1000 * other], axis=1)
            print(f"{name}, {what}: {ratio:.2f} ({times[0]:.0f} over {times[1]:.0f} ms)")
        for lamp in lamps:
            bpy.data.lights.remove(lamp.data)
        if name.endswith("mesh"):
            bpy.data.objects.remove(bpy.data.objects["Suzanne"])


if __name__ == "__main__":
    main()
