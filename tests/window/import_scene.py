"""Runs inside a Blender with a window: imports and exports cameras as a user does, to the end and
to Esc, with other actions meanwhile.

`blender --factory-startup --enable-event-simulate -P tests/window/import_scene.py -- FOLDER
PACKAGES...`; PACKAGES are folders with the packages missing in Blender's Python. FOLDER has a copy
of the studio capture. Writes FOLDER/seen.json and pictures of the screen.
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
FOLDER, *PACKAGES = map(Path, sys.argv[sys.argv.index("--") + 1 :])
sys.path[:0] = [str(ROOT), *map(str, PACKAGES)]

import addon_utils  # noqa: E402 - the path comes first
import bpy  # noqa: E402

addon_utils.enable("addon", default_set=True, persistent=True)

from addon.cameras import camera_path, camera_path_import, export_colmap, importing  # noqa: E402
from addon.cameras.objects import cameras_of, points_of  # noqa: E402
from addon.interface import incremental_operator  # noqa: E402
from tests.window.blocking import Held  # noqa: E402
from tools.window.window_script import (  # noqa: E402
    ScriptRunner,
    area,
    clear,
    save_screenshot,
    send,
    space,
    write_results,
)

STUDIO = FOLDER / "studio"
KINDS = ("objects", "cameras", "meshes", "collections", "images", "actions")
seen: dict = {"log": []}
said: list[str] = []


def window() -> bpy.types.Window:
    """The main one."""
    return bpy.context.window_manager.windows[0]


def invoke(name: str, **settings: Any) -> list[str]:
    """Press a button."""
    with bpy.context.temp_override(window=window(), area=area()):
        return list(getattr(bpy.ops.gscore, name)("INVOKE_DEFAULT", **settings))


def rests() -> bool:
    """True if no operator or job of the add-on is running."""
    return not any(one.bl_idname.startswith("GSCORE") for one in window().modal_operators)


def press(key: str) -> None:
    """A key, over the 3D view."""
    for value in ("PRESS", "RELEASE"):
        send(key, value)


def step(way: str) -> None:
    """Undo or redo."""
    with bpy.context.temp_override(window=window(), area=area()):
        getattr(bpy.ops.ed, way)()


def counts() -> dict[str, int]:
    """Number of datablocks by kind."""
    return {kind: len(getattr(bpy.data, kind)) for kind in KINDS}


def coming() -> bool:
    """True while cameras are being imported."""
    return any("gs_temporary" in one for one in bpy.data.collections)


def half() -> bool:
    """True once some of them exist."""
    return coming() and len(bpy.data.cameras) > 10


def given_up() -> Iterator[object]:
    """Esc while the capture is read, and while cameras are created; the sidebar is opened
    meanwhile."""
    before = counts()
    held = Held(importing, "read")
    seen["begun"] = invoke("import_cameras", directory=str(STUDIO))
    yield held.began.is_set
    yield 0.6
    save_screenshot(FOLDER / "reading.png")
    shown = space().show_region_ui
    press("N")
    yield 0.5
    seen["alive"] = space().show_region_ui != shown and not rests()
    press("ESC")
    yield rests
    held.let_go()
    yield 0.5
    seen["after reading"] = counts() == before
    invoke("import_cameras", directory=str(STUDIO))
    yield half
    seen["scene meanwhile"] = len(bpy.context.scene.objects)
    press("ESC")
    yield rests
    yield lambda: not coming()  # the import runs in steps
    yield 0.3
    seen["after cameras"] = counts() == before
    seen["said"] = list(said)


def to_the_end() -> Iterator[object]:
    """The whole import, one undo step."""
    invoke("import_cameras", directory=str(STUDIO))
    yield rests
    root = bpy.context.object
    seen["made"] = root.name, len(cameras_of(root)), len(points_of(root).data.vertices)
    seen["images"] = len(bpy.data.images)
    yield 1.0
    save_screenshot(FOLDER / "imported.png")
    step("undo")
    seen["undone"] = len(bpy.data.cameras), len(bpy.context.scene.objects)
    step("redo")
    seen["redone"] = len(cameras_of(bpy.data.objects["studio"]))


def anew() -> Iterator[object]:
    """A camera is moved and one removed; Esc keeps that, a complete import does not."""
    root = bpy.data.objects["studio"]
    first, second = (ob.name for ob in cameras_of(root)[:2])
    bpy.data.objects[first].location.x = 50
    bpy.data.cameras.remove(bpy.data.objects[second].data)
    with bpy.context.temp_override(window=window(), area=area()):
        bpy.ops.ed.undo_push(message="by hand")
    held = Held(importing, "read")
    invoke("import_cameras", capture="studio")
    yield held.began.is_set
    held.let_go()
    yield coming
    press("ESC")
    yield rests
    seen["moved after Esc"] = bpy.data.objects[first].location.x
    seen["count after Esc"] = len(cameras_of(bpy.data.objects["studio"]))
    invoke("import_cameras", capture="studio")
    yield rests
    seen["moved anew"] = bpy.data.objects[first].location.x
    seen["count anew"] = len(cameras_of(bpy.data.objects["studio"]))
    step("undo")
    seen["moved undone"] = bpy.data.objects[first].location.x


def exported() -> Iterator[object]:
    """Esc before any file is written; then to the end."""
    held = Held(export_colmap, "_write")
    seen["export"] = invoke_export("given up")
    yield held.began.is_set
    press("ESC")
    yield rests
    held.let_go()
    yield 1.0
    seen["given up"] = [p.name for p in (FOLDER / "given up").rglob("*") if p.is_file()]
    invoke_export("written")
    yield rests
    seen["written"] = sorted(p.name for p in (FOLDER / "written").rglob("*") if p.is_file())


def invoke_export(name: str) -> list[str]:
    """Export as after a folder was chosen."""
    from addon.cameras.operators import ExportCameras

    ExportCameras.invoke = lambda self, context, event: self.execute(context)  # no file browser
    return invoke("export_cameras", directory=str(FOLDER / name))


def chosen(file: Path) -> Iterator[object]:
    """Choose a file in the browser that a button has opened."""
    yield lambda: any(a.type == "FILE_BROWSER" for a in window().screen.areas)
    yield 0.5
    browser = next(a for a in window().screen.areas if a.type == "FILE_BROWSER")
    params = browser.spaces.active.params
    params.directory, params.filename = str(file.parent).encode(), file.name
    with bpy.context.temp_override(window=window(), area=browser):
        bpy.ops.file.execute()


def pressed(name: str, file: Path) -> Iterator[object]:
    """Press a button of camera paths; wait until it is running."""
    seen[name] = invoke(name, world="BLENDER")
    yield from chosen(file)
    yield lambda: not rests()


def paths() -> Iterator[object]:
    """Export a path while a user moves along the timeline, and import it; each with Esc before."""
    bpy.context.preferences.view.filebrowser_display_type = "SCREEN"
    camera_path.BUDGET = camera_path_import.BUDGET = 0.0  # a frame, or a curve, per step
    scene, file = bpy.context.scene, FOLDER / "walk.json"
    ob = scene.camera = cameras_of(bpy.data.objects["studio"])[0]
    scene.frame_start, scene.frame_end = 1, 100
    for number in (1, 100):
        ob.location.x = number
        ob.keyframe_insert("location", frame=number)
    scene.frame_set(7)
    with bpy.context.temp_override(window=window(), area=area()):
        bpy.ops.ed.undo_push(message="by hand")
    yield from pressed("export_camera_path", file)
    yield 0.2
    press("ESC")
    yield rests
    seen["path given up"] = file.exists(), scene.frame_current
    yield from pressed("export_camera_path", file)
    yield 0.2
    at = scene.frame_current
    scene.frame_set(40)
    yield 0.2
    save_screenshot(FOLDER / "path.png")
    seen["path meanwhile"] = at, scene.frame_current, rests()
    yield rests
    seen["path"] = file.is_file(), scene.frame_current
    before = counts()
    held = Held(camera_path_import, "_read")
    yield from pressed("import_camera_path", file)
    press("ESC")
    yield rests
    held.let_go()
    yield 0.5
    seen["path not in"] = counts() == before
    yield from pressed("import_camera_path", file)
    yield rests
    seen["path in"] = scene.camera.name, scene.frame_end, bpy.context.object.name
    step("undo")
    camera = bpy.context.scene.camera
    seen["path undone"] = counts() == before, camera and camera.name


def by_menu() -> Iterator[object]:
    """File > Import opens the file browser, although the panel names a folder."""
    bpy.context.preferences.view.filebrowser_display_type = "SCREEN"
    seen["menu"] = invoke("import_cameras", browse=True)
    yield lambda: any(a.type == "FILE_BROWSER" for a in window().screen.areas)
    yield 1.0
    save_screenshot(FOLDER / "browser.png")
    browser = next(a for a in window().screen.areas if a.type == "FILE_BROWSER")
    seen["folder"] = browser.spaces.active.params.directory.decode().rstrip("/")
    with bpy.context.temp_override(window=window(), area=browser):
        bpy.ops.file.execute()
    yield 1.0
    yield rests
    seen["by menu"] = len(bpy.data.cameras)


def story() -> Iterator[object]:
    """All parts, one after the other."""
    importing.BUDGET = 0.0  # one camera per step, so that there is time to press a key
    clear()
    bpy.data.batch_remove([*bpy.data.cameras, *bpy.data.meshes, *bpy.data.lights])
    say = incremental_operator.StatusBar.show
    incremental_operator.StatusBar.show = lambda self, text: (
        said.append(text or ""),
        say(self, text),
    )[1]
    with bpy.context.temp_override(window=window(), area=area()):
        bpy.ops.ed.undo_push(message="start")
    yield 0.5
    yield from given_up()
    yield from to_the_end()
    yield from anew()
    yield from exported()
    yield from paths()
    yield from by_menu()


ScriptRunner(story(), write_results(FOLDER, seen))
