"""Runs inside a Blender with a window: paints with simulated mouse and keys, takes screenshots.

`blender --factory-startup --enable-event-simulate -P tests/window/paint_scene.py -- FOLDER
PACKAGES...`; PACKAGES are folders with the packages missing in Blender's Python. Writes
FOLDER/seen.json and pictures of the screen.
"""

import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDER, *PACKAGES = map(Path, sys.argv[sys.argv.index("--") + 1 :])
sys.path[:0] = [str(ROOT), *map(str, PACKAGES)]

import addon_utils  # noqa: E402 - the path comes first
import bpy  # noqa: E402
import numpy as np  # noqa: E402

addon_utils.enable("addon", default_set=True, persistent=True)

from addon import attributes  # noqa: E402
from addon.paint import modal  # noqa: E402
from tests.addon import splat_scenes as lab  # noqa: E402
from tools.window.window_script import (  # noqa: E402
    ScriptRunner,
    area,
    at_rest,
    clear,
    look_down,
    region,
    save_screenshot,
    send,
    write_results,
)

WALL, BRUSH = (0.8, 0.4, 0.2), (0.05, 0.2, 0.9)
PAUSE = 0.2
"""Seconds in which Blender has handled an event and drawn the result."""
seen: dict = {"log": []}


def move(*way: int, **held: bool) -> Iterator[float]:
    """Move the mouse along the view's middle, with the current buttons pressed."""
    for aside in way:
        yield PAUSE
        send("MOUSEMOVE", "NOTHING", aside, **held)
    yield PAUSE


def drag(*way: int, **held: bool) -> Iterator[float]:
    """Drag with the left mouse button along the view's middle, without a release."""
    send("MOUSEMOVE", "NOTHING", way[0])
    yield PAUSE
    send("LEFTMOUSE", "PRESS", way[0], **held)
    yield from move(*way[1:], **held)


def let_go(aside: int) -> Iterator[object]:
    """End a drag."""
    send("LEFTMOUSE", "RELEASE", aside)
    yield PAUSE
    yield at_rest


def press(key: str, **held: bool) -> Iterator[object]:
    """A key, and the mouse's next move."""
    send(key, "PRESS", **held)
    send(key, "RELEASE", **held)
    yield PAUSE
    send("MOUSEMOVE", "NOTHING", 1)
    yield PAUSE
    yield at_rest


def screenshot(name: str) -> None:
    """Save the screen as a file."""
    save_screenshot(FOLDER / f"{name}.png")


def begin() -> list[str]:
    """Press the button."""
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window, area=area(), region=region()):
        return sorted(bpy.ops.gscore.paint_splats("INVOKE_DEFAULT"))


def base() -> np.ndarray:
    """[N, 4] of `radiance:base` in Blender's mesh."""
    return attributes.column(bpy.data.objects["wall"].data, attributes.BASE)


def choose(tool: str) -> None:
    """Activate a tool of the 3D view."""
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window, area=area(), region=region()):
        bpy.ops.wm.tool_set_by_id(name=tool)


def by_tool(brush: bpy.types.PropertyGroup) -> Iterator[object]:
    """A stroke by the tool, and its radius set by keys."""
    choose("gscore.paint_tool")
    brush.does, before = "COLOR", base()
    yield from drag(-90, -80)
    seen["tool_begins"] = modal.RUNNING.session is not None
    yield from let_go(-80)
    seen["tool_paints"] = bool((base() != before).any())
    seen["tool_ends"] = modal.RUNNING.session is None
    screenshot("tool")
    seen["radius"] = [brush.radius]
    yield from press("RIGHT_BRACKET")
    seen["radius"].append(brush.radius)
    send("F")
    yield from move(10, 60)
    send("LEFTMOUSE", "PRESS", 60)
    send("LEFTMOUSE", "RELEASE", 60)
    yield PAUSE
    seen["radius"].append(brush.radius)
    choose("builtin.select_box")


def story() -> Iterator[object]:
    """The events; a yield returns control to Blender (`ScriptRunner`)."""
    clear()
    view = look_down()
    wall = lab.add(bpy.context.scene, lab.wall(0.0, WALL), "wall")
    bpy.context.view_layer.objects.active = wall
    bpy.ops.ed.undo_push(message="wall")
    brush = bpy.context.window_manager.gscore_paint
    brush.radius, brush.color, brush.hardness = 40, BRUSH, 0.8
    yield at_rest
    yield 1.0
    main = region()
    seen["middle"] = [main.x + main.width // 2, main.y + main.height // 2]
    seen["begun"], plain = begin(), base()
    yield PAUSE
    yield from drag(-60, -20, 20, 60)
    yield at_rest
    seen["mesh_waits"] = bool((base() == plain).all())
    screenshot("while")
    yield from let_go(60)
    colored = base()
    seen["mesh_follows"] = bool((colored != plain).any())
    screenshot("color")
    yield from press("Z", ctrl=True)
    seen["undone"] = bool((base() == plain).all())
    screenshot("undone")
    yield from press("Z", ctrl=True, shift=True)
    seen["redone"] = bool((base() == colored).all())
    brush.does = "OPACITY"
    yield from drag(-60, 0)
    yield from let_go(0)
    screenshot("erased")
    brush.does = "SELECT"
    yield from drag(40, 60)
    yield from let_go(60)
    seen["selected"] = int(attributes.selected(bpy.data.objects["wall"].data).sum())
    before = view.view_rotation.copy()
    send("MIDDLEMOUSE")
    yield from move(10, 20)
    send("MIDDLEMOUSE", "RELEASE", 20)
    yield PAUSE
    seen["turned"] = view.view_rotation != before
    yield from press("X")
    seen["kept"] = "wall" in bpy.data.objects
    yield from press("ESC")
    seen["ended"] = modal.RUNNING.session is None
    yield from by_tool(brush)
    seen["begun_again"], kept = begin(), base()
    yield from drag(0, 20)
    cursor = modal.RUNNING.session.cursor
    addon_utils.disable("addon", default_set=True)
    seen["ended_with_the_addon"] = cursor._handle is None and bool((base() == kept).all())
    yield PAUSE


ScriptRunner(story(), write_results(FOLDER, seen))
