"""Camera import and export in Blender: times, and blocking of the main thread.

    python tools/measure/cameras.py [CAPTURE...] [--others N] [--frames N...]    (a Python with bpy)

Each operator runs in short steps as in a window, to its end or to Esc, and so does the later
removal of unused data. Prints, for each capture and path: total seconds, CPU milliseconds of the
longest step of the main thread, and the largest delay of its wake-up in milliseconds, caused by
threads that hold Python's lock or by other programs.
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

from tools.measure.windowless import steps, windowless  # noqa: E402 - the path comes first


def parse() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("captures", type=Path, nargs="*", metavar="CAPTURE")
    parser.add_argument("--others", type=int, default=0, help="other objects in the scene")
    parser.add_argument("--frames", type=int, nargs="*", default=(250, 2500), help="path lengths")
    return parser.parse_args()


def measured(name: str, operator: str, **settings: Any) -> None:
    """Print the times of an operator call, and of the removal of unused data afterwards."""
    bpy.context.view_layer.update()
    printed(name, begun(operator, **settings))
    printed("  removed afterwards", removal())


def begun(operator: str, **settings: Any) -> Any:
    """A started operator, as from a button."""
    from addon.process.incremental_tasks import TaskRunner

    return TaskRunner(windowless(operator, **settings).steps(bpy.context))


def removal() -> Any:
    """The removal of unused data, as a task."""
    from addon.interface.incremental_removal import clearing
    from addon.process.incremental_tasks import TaskRunner

    return TaskRunner(clearing())


def printed(name: str, going: Any) -> None:
    """Run a task and print its times."""
    began = time.perf_counter()
    own, late = map(max, zip(*steps(going), strict=True))
    took = time.perf_counter() - began
    print(f"{name:28} {took:6.2f} s {own * 1e3:6.1f} ms {late * 1e3:6.1f} ms", flush=True)


def given_up(folder: str) -> None:
    """Print the time of Esc after all cameras were created."""
    count = len(bpy.data.cameras)
    bpy.ops.wm.read_homefile(use_empty=True)
    going = begun("import_cameras", directory=folder)
    while len(bpy.data.cameras) < count:
        going.step()
    began = time.thread_time()
    going.cancel()
    print(f"{'Import Cameras, Esc':28} {(time.thread_time() - began) * 1e3:18.1f} ms")
    printed("  removed afterwards", removal())


def have_moved() -> None:
    """Change the poses and lenses of all cameras."""
    from addon.cameras.objects import is_camera

    for ob in filter(is_camera, bpy.data.objects):
        viewmat = ob["gs_viewmat"].to_list()
        viewmat[3] += 0.01
        ob["gs_viewmat"] = viewmat
        ob.location.x += 0.01
        ob.data.lens += 3


def have_gone() -> None:
    """Replace the photo names of half of the cameras."""
    for ob in bpy.data.objects:
        if ob.type == "CAMERA" and ob.name.endswith(tuple("02468")):
            ob["gs_image"] = f"gone/{ob['gs_image']}"


def measured_path(frames: int) -> None:
    """Print the times of exporting and importing a camera path in an empty scene."""
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
            for _ in range(options.others):
                bpy.context.collection.objects.link(bpy.data.objects.new("other", None))
            folder = str(capture.resolve())
            print(folder)
            measured("Import Cameras", "import_cameras", directory=folder)
            measured("Import Cameras, again", "import_cameras", directory=folder)
            have_moved()
            measured("the same, all differ", "import_cameras", directory=folder)
            have_gone()
            measured("the same, half is gone", "import_cameras", directory=folder)
            measured("Export Cameras", "export_cameras", directory=tempfile.mkdtemp())
            target = tempfile.mkdtemp()
            measured(
                "Export, transforms.json", "export_cameras", directory=target, kind="TRANSFORMS"
            )
            given_up(folder)
        for frames in options.frames:
            bpy.ops.wm.read_homefile(use_empty=True)
            print(f"{frames} frames")
            measured_path(frames)
    finally:
        addon.unregister()
        sys.stdout.flush()


if __name__ == "__main__":
    main()
