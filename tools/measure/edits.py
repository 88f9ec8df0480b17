"""How long the buttons of *Edit Splats* hold Blender, of a million splats.

    python tools/measure/edits.py [--cameras CAPTURE] [--splats N]    (a Python with bpy)

Splats of SH degree 3 lie on spheres, as those of captures lie on surfaces, with some floating
around. Prints the seconds of two calls of each operator, with entering Edit Mode where it ends in
it, and without the undo step. *Separate* takes half of them away, *Join* brings as many back,
turned, *Turn Shapes and Colors Along* comes after Blender's Apply, *Decimate* keeps half, and
compares pictures from around the splats or, with a capture, from its cameras.
"""

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
SPHERES, RADII = 5, (1.0, 0.5, 0.3)
FLOATING = 200
"""Of so many splats one floats."""


def parse() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cameras", type=Path, metavar="CAPTURE")
    parser.add_argument("--splats", type=int, default=1_000_000)
    return parser.parse_args()


def surfaces(count: int) -> dict[str, np.ndarray]:
    """The arrays of `Splats`: thin ones on spheres side by side."""
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


def timed(name: str, act: Callable[[], object]) -> None:
    """Print the seconds of one call from Object Mode, and end there."""
    bpy.ops.ed.undo_push(message=name)
    began = time.perf_counter()
    act()
    print(f"{name}: {time.perf_counter() - began:.2f} s", flush=True)
    if bpy.context.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")


def main() -> None:
    """Measure and print."""
    options = parse()
    sys.path.insert(0, str(ROOT))
    import addon
    from addon import attributes
    from addon.cameras.objects import root_of
    from addon.core import Splats
    from addon.splats import objects

    addon.register()
    try:
        bpy.ops.wm.read_homefile(use_empty=True)
        scene, parent = bpy.context.scene, None
        if options.cameras:
            bpy.ops.gscore.import_cameras(directory=str(options.cameras.resolve()))
            parent = root_of(next(ob for ob in bpy.data.objects if ob.type == "CAMERA"))
        act = bpy.ops.gscore
        splats = Splats(**surfaces(options.splats))
        for _ in range(2):
            ob = objects.create(splats, "splats", collection=scene.collection)
            ob.parent = parent
            bpy.context.view_layer.objects.active = ob
            attributes.select(ob.data, np.arange(options.splats) == 1)
            timed("Color", act.select_by_color)
            attributes.select(ob.data, np.arange(options.splats) == 1)
            timed("Flood", act.select_flood)
            timed("Grade", lambda: act.grade_splats(saturation=0.5))
            timed("Floaters", act.select_floaters)
            attributes.select(ob.data, np.arange(options.splats) % 2 == 0)
            timed("Separate", act.separate_splats)
            part = next(o for o in scene.objects if objects.is_splats(o) and o is not ob)
            part.rotation_euler = (0.1, 0.2, 0.3)
            for one in (part, ob):
                one.select_set(True)
            timed("Join", act.join_splats)
            ob.rotation_euler = (0.1, 0.2, 0.3)
            bpy.ops.object.select_all(action="DESELECT")
            ob.select_set(True)
            bpy.ops.object.transform_apply()
            timed("Turn Shapes and Colors Along", act.mend_splats)
            timed("Decimate", lambda: act.decimate_splats(count=options.splats // 2))
            bpy.data.objects.remove(ob)
    finally:
        addon.unregister()
        sys.stdout.flush()


if __name__ == "__main__":
    main()
