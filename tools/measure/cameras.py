"""How long Import Cameras, the same anew, Export Cameras, and both of camera paths take, and hold
Blender.

    python tools/measure/cameras.py [CAPTURE...]    (a Python with bpy)

Each operator goes on bit by bit as in a window. Prints, of each capture and each path: the seconds
to its end, the processor milliseconds of the longest step of the main thread, and the most
milliseconds that the main thread woke later than it asked to, as when a thread keeps Python's lock,
or other programs the processor.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import bpy

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))
FRAMES = 250, 2500
"""Of camera paths."""

from tools.measure.stand_in import stand_in, steps  # noqa: E402 - the path comes first


def parse() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("captures", type=Path, nargs="*", metavar="CAPTURE")
    return parser.parse_args()


def measured(name: str, operator: str, **settings: Any) -> None:
    """Print what one call of an operator takes."""
    from addon.process.pieces import Going

    bpy.context.view_layer.update()
    began = time.perf_counter()
    going = Going(stand_in(operator, **settings).pieces(bpy.context))
    own, late = map(max, zip(*steps(going), strict=True))
    took = time.perf_counter() - began
    print(f"{name:28} {took:6.2f} s {own * 1e3:6.0f} ms {late * 1e3:6.0f} ms", flush=True)


def measured_path(frames: int) -> None:
    """Print what a path of a camera takes that moves and zooms in an empty scene."""
    scene = bpy.context.scene
    ob = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(ob)
    scene.camera, scene.frame_start, scene.frame_end = ob, 1, frames
    for number in range(1, frames + 1, 10):
        ob.location.x, ob.data.lens = 0.01 * number, 30 + number % 7
        ob.keyframe_insert("location", frame=number)
        ob.data.keyframe_insert("lens", frame=number)
    for kind in ("CAMERAS", "TRANSFORMS", "NERFSTUDIO"):
        scene.camera, file = ob, str(Path(tempfile.mkdtemp()) / "path.json")
        given = {"filepath": file, "world": "BLENDER"}
        measured(f"Export Path, {kind.lower()}", "export_camera_path", kind=kind, **given)
        measured(f"Import Path, {kind.lower()}", "import_camera_path", **given)


def main() -> None:
    """Measure and print."""
    options = parse()
    import addon

    addon.register()
    try:
        print(f"Blender {bpy.app.version_string}")
        print(f"{'':28} {'whole':>8} {'longest':>9} {'late':>9}")
        for capture in options.captures:
            bpy.ops.wm.read_homefile(use_empty=True)
            folder = str(capture.resolve())
            print(folder)
            measured("Import Cameras", "import_cameras", directory=folder)
            measured("Import Cameras, anew", "import_cameras", directory=folder)
            measured("Export Cameras", "export_cameras", directory=tempfile.mkdtemp())
            target = tempfile.mkdtemp()
            measured(
                "Export, transforms.json", "export_cameras", directory=target, kind="TRANSFORMS"
            )
        for frames in FRAMES:
            bpy.ops.wm.read_homefile(use_empty=True)
            print(f"{frames} frames")
            measured_path(frames)
    finally:
        addon.unregister()
        sys.stdout.flush()


if __name__ == "__main__":
    main()
