"""Runs inside a Blender with a window: presses buttons of incremental operators, ends some with
Esc, and changes the splats of others meanwhile.

`blender --factory-startup --enable-event-simulate -P tests/window/stepping_scene.py -- FOLDER
PACKAGES...`; PACKAGES are folders with the packages missing in Blender's Python. Writes
FOLDER/seen.json and a picture of the screen.
"""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
FOLDER, *PACKAGES = map(Path, sys.argv[sys.argv.index("--") + 1 :])
sys.path[:0] = [str(ROOT), *map(str, PACKAGES)]

import addon_utils  # noqa: E402 - the path comes first
import bpy  # noqa: E402
import numpy as np  # noqa: E402

addon_utils.enable("addon", default_set=True, persistent=True)

from addon import attributes  # noqa: E402
from addon.core import join_splats  # noqa: E402
from addon.render import decimate, picture  # noqa: E402
from addon.splats import objects, select_operators  # noqa: E402
from tests.addon import splat_scenes as lab  # noqa: E402
from tests.addon.calls import import_capture  # noqa: E402
from tests.window.blocking import Held  # noqa: E402
from tools.window.window_script import ScriptRunner, area, clear, save_screenshot, write_results  # noqa: E402

seen: dict = {"log": []}
COUNT = 3000


def operate(name: str, *how: str, **settings: Any) -> list[str]:
    """Call an operator of the add-on in the 3D view; with INVOKE_DEFAULT as its button does."""
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window, area=area()):
        return list(getattr(bpy.ops.gscore, name)(*how, **settings))


def invoke(name: str, **settings: Any) -> list[str]:
    """Press a button."""
    return operate(name, "INVOKE_DEFAULT", **settings)


def rests() -> bool:
    """True if no operator or job of the add-on is running."""
    running = bpy.context.window_manager.windows[0].modal_operators
    return not any(one.bl_idname.startswith("GSCORE") for one in running)


def escape() -> None:
    """Press Esc."""
    window = bpy.context.window_manager.windows[0]
    for value in ("PRESS", "RELEASE"):
        window.event_simulate("ESC", value, x=300, y=300)


def undo() -> None:
    """Undo one step."""
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window, area=area()):
        bpy.ops.ed.undo()


def push() -> None:
    """Push an undo step."""
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window, area=area()):
        bpy.ops.ed.undo_push(message="before")


def ob() -> bpy.types.Object:
    """The splats, which undo may have replaced."""
    return bpy.data.objects["splats"]


def mode(name: str) -> None:
    """Enter a mode."""
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window, area=area()):
        bpy.ops.object.mode_set(mode=name)


def chosen() -> list[int]:
    """Numbers of the selected splats, in Object Mode afterwards."""
    mode("OBJECT")
    return np.flatnonzero(attributes.selected(ob().data)).tolist()


def seed() -> None:
    """Select one splat, in Object Mode."""
    mode("OBJECT")
    attributes.select(ob().data, np.arange(COUNT) == 3)
    ob().data.update()


def begin() -> None:
    """Two balls of splats, the one object of the scene."""
    clear()
    bpy.data.orphans_purge()  # or the name is taken
    balls = [lab.blob(COUNT // 2, size=1.0), lab.blob(COUNT // 2, center=(9, 0, 0), size=1.0)]
    lab.add(bpy.context.scene, join_splats(balls), "splats")
    bpy.context.view_layer.objects.active = ob()
    ob().select_set(True)


def as_at_once() -> Iterator[object]:
    """A button has the same effect as a script's single call, as one undo step."""
    seed()
    operate("select_flood", gap=1.0)
    seen["at once"] = chosen()
    seed()
    push()
    yield 0.5
    seen["begun"] = invoke("select_flood", gap=1.0)
    seen["under way"] = not rests()
    yield rests
    seen["mode"], seen["bit by bit"] = ob().mode, chosen()
    mode("EDIT")
    yield 0.5
    undo()
    yield 0.5
    seen["undone"] = chosen()


def given_up() -> Iterator[object]:
    """Esc in Edit Mode, during a search for splats."""
    seed()
    mode("EDIT")
    yield 0.5
    held = Held(select_operators, "flooded")
    invoke("select_flood", gap=1.0)
    yield held.began.is_set
    seen["meanwhile"] = ob().mode
    escape()
    yield rests
    held.let_go()
    yield 0.5
    seen["mode after Esc"], seen["after Esc"] = ob().mode, chosen()


def disturbed(name: str, act: Callable[[], object]) -> Iterator[object]:
    """Changes of the scene while splats are compared."""
    held = Held(decimate, "similarity")
    invoke("decimate_splats", count=500)
    yield held.began.is_set
    act()
    yield 0.5
    held.let_go()
    yield rests
    seen[name] = len(ob().data.vertices)


def paint() -> None:
    """Change colors."""
    operate("grade_splats", saturation=0.0)


def compared() -> Iterator[object]:
    """A photo comparison, while the picture of the splats is drawn; then cancelled."""
    clear()
    scene = bpy.context.scene
    capture = import_capture(scene, ROOT / "examples" / "studio", photos=False)
    values = np.empty(3 * len(capture.points.data.vertices), np.float32)
    capture.points.data.attributes["position"].data.foreach_get("vector", values)
    blob = lab.blob(len(values) // 3)
    fields = {n: getattr(blob, n) for n in ("quats", "opacities", "sh0", "shN")}
    means = values.reshape(-1, 3)
    splats = type(blob)(means=means, scales=blob.scales - 0.5, **fields)
    objects.create(splats, "splats", collection=capture.collection, parent=capture.root)
    first, other = (camera.name for camera in capture.cameras[9:11])
    yield 1.0
    held = Held(picture, "draw")
    seen["compare"] = invoke("compare_photo", camera=other)
    yield held.began.is_set
    escape()
    yield rests
    held.let_go()
    yield 0.5
    seen["given up"] = "gs_psnr" in scene.objects[other], len(bpy.data.images)
    invoke("compare_photo", camera=first)
    yield rests
    yield 2.0
    seen["psnr"] = scene.objects[first]["gs_psnr"]
    seen["windows"] = len(bpy.context.window_manager.windows)
    image = bpy.data.images["GS Comparison"]
    seen["size"], seen["dirty"] = list(image.size), image.is_dirty
    seen["packed"] = image.packed_file is not None
    save_screenshot(FOLDER / "compared.png")


def repeated() -> Iterator[object]:
    """An edit, then Repeat Last."""
    begin()
    yield 0.5
    invoke("decimate_splats", count=1500)
    yield rests
    manager = bpy.context.window_manager
    manager.operators[-1].properties.count = 700
    with bpy.context.temp_override(window=manager.windows[0], area=area()):
        bpy.ops.screen.repeat_last()
    seen["repeated"] = rests(), len(ob().data.vertices)
    yield 1.0


def without_workspace() -> Iterator[object]:
    """The workspace with the status bar of an edit is deleted."""
    begin()
    window = bpy.context.window_manager.windows[0]
    before = window.workspace
    with bpy.context.temp_override(window=window, area=area()):
        bpy.ops.workspace.duplicate()
    yield 0.5
    held = Held(decimate, "similarity")
    invoke("decimate_splats", count=500)
    yield held.began.is_set
    added, window.workspace = window.workspace, before
    yield 0.5
    bpy.data.batch_remove([added])
    held.let_go()
    yield rests
    seen["without workspace"] = len(ob().data.vertices)


def disabled() -> Iterator[object]:
    """The add-on is disabled during a search for splats, and enabled again."""
    begin()
    yield 0.5
    held = Held(select_operators, "flooded")
    seed()
    mode("EDIT")
    invoke("select_flood", gap=1.0)
    yield held.began.is_set
    meshes = len(bpy.data.meshes)
    addon_utils.disable("addon")
    held.let_go()
    seen["disabled"] = ob().mode, len(bpy.data.meshes) == meshes
    yield 0.5
    mode("OBJECT")
    seen["chosen when disabled"] = chosen()
    addon_utils.enable("addon", persistent=True)
    yield 0.5


def story() -> Iterator[object]:
    """All parts, one after the other."""
    yield from repeated()
    yield from without_workspace()
    begin()
    yield 1.0
    yield from as_at_once()
    yield from given_up()
    yield from disturbed("painted", paint)
    push()
    paint()
    push()
    yield 0.5
    yield from disturbed("undone meanwhile", undo)
    yield from disturbed("Esc", escape)
    seen["meshes"] = [m.name for m in bpy.data.meshes if "gs_temporary" in m]
    yield from disturbed("nothing", lambda: None)
    yield from disabled()
    yield from compared()


ScriptRunner(story(), write_results(FOLDER, seen))
