"""Runs inside a Blender with a window: exports splats as a user does, once to the end, once to Esc.

`blender --factory-startup --enable-event-simulate -P tests/window/export_scene.py -- FOLDER
PACKAGES...`; PACKAGES are folders with the packages missing in Blender's Python. Writes
FOLDER/seen.json.
"""

import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
FOLDER, *PACKAGES = map(Path, sys.argv[sys.argv.index("--") + 1 :])
sys.path[:0] = [str(ROOT), *map(str, PACKAGES)]

import addon_utils  # noqa: E402 - the path comes first
import bpy  # noqa: E402

addon_utils.enable("addon", default_set=True, persistent=True)

from addon.splats import exporting, objects  # noqa: E402
from addon.splats.file_operators import ExportSplats  # noqa: E402
from tests.addon import splat_scenes as lab  # noqa: E402
from tests.addon.calls import export_splats  # noqa: E402
from tools.window.window_script import ScriptRunner, area, clear, write_results  # noqa: E402

seen: dict = {"log": []}


def export(name: str) -> set[str]:
    """Call the operator as its entry of the menu does, after a file was chosen."""
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window, area=area()):
        return bpy.ops.gscore.export_splats("INVOKE_DEFAULT", filepath=str(FOLDER / name))


def under_way() -> bool:
    """True while it is running."""
    running = bpy.context.window_manager.windows[0].modal_operators
    return any(one.bl_idname == "GSCORE_OT_export_splats" for one in running)


def story() -> Iterator[object]:
    """Export, and cancel another file while it is written."""
    clear()
    ob = objects.create(lab.blob(3000), "blob")
    bpy.context.view_layer.objects.active = ob
    ExportSplats.invoke = lambda self, context, event: self.execute(context)  # no file browser
    yield 1.0
    export_splats([ob], FOLDER / "at once.ply")
    seen["begun"], seen["under_way"] = list(export("bit by bit.ply")), under_way()
    yield lambda: not under_way()
    names = ("at once.ply", "bit by bit.ply")
    seen["same"] = len({(FOLDER / name).read_bytes() for name in names}) == 1
    write, go_on = exporting.write_splat_file, threading.Event()

    def slow(*args: Any, **options: Any) -> Any:
        assert go_on.wait(60)
        return write(*args, **options)

    exporting.write_splat_file = slow
    export("given up.ply")
    yield 1.0
    seen["still"] = under_way()
    window = bpy.context.window_manager.windows[0]
    window.event_simulate("ESC", "PRESS", x=300, y=300)
    window.event_simulate("ESC", "RELEASE", x=300, y=300)
    yield 1.0
    seen["ended"] = not under_way()
    go_on.set()
    yield 1.0
    seen["meshes"] = [mesh.name for mesh in bpy.data.meshes if "gs_temporary" in mesh]


ScriptRunner(story(), write_results(FOLDER, seen))
