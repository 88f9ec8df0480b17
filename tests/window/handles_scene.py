"""Runs inside a Blender with a window: drags the handles of histograms with a simulated mouse.

`blender --factory-startup --enable-event-simulate -P tests/window/handles_scene.py -- FOLDER
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

from addon.histograms import gizmos  # noqa: E402
from addon.histograms.counting import OPACITY, SIZE  # noqa: E402
from tests.addon import splat_scenes as lab  # noqa: E402
from tools.window.window_script import (  # noqa: E402
    ScriptRunner,
    area,
    at_rest,
    clear,
    look_down,
    region,
    save_screenshot,
    space,
    write_results,
)

PAUSE = 0.2
"""Seconds in which Blender has handled an event and drawn the result."""
LIMITS = "opacity_min", "size_min", "size_max"
seen: dict = {"log": []}


def box(kind: str) -> list[float]:
    """Left, bottom, width and height of a histogram, in the window."""
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window, area=area(), region=region()):
        found = gizmos.box_of(bpy.context, kind)
    return [found.x + region().x, found.y + region().y, found.width, found.height]


def mouse(kind: str, place: float, key: str, value: str, **held: bool) -> Iterator[float]:
    """An event at a place along a histogram, half way up."""
    left, bottom, width, height = box(kind)
    x, y = round(left + place * width), round(bottom + height / 2)
    bpy.context.window_manager.windows[0].event_simulate(key, value, x=x, y=y, **held)
    yield PAUSE


def take(kind: str, place: float) -> Iterator[float]:
    """Press the mouse there; Blender looks for gizmos below it when it moves."""
    for near in (place - 0.01, place):
        yield from mouse(kind, near, "MOUSEMOVE", "NOTHING")
    yield from mouse(kind, place, "LEFTMOUSE", "PRESS")


def drag(kind: str, start: float, end: float, *, fine: bool = False) -> Iterator[float]:
    """From place to place, in several moves."""
    yield from take(kind, start)
    if fine:
        yield from mouse(kind, start, "LEFT_SHIFT", "PRESS", shift=True)
    for place in np.linspace(start, end, 5)[1:]:
        yield from mouse(kind, place, "MOUSEMOVE", "NOTHING", shift=fine)
    if fine:
        yield from mouse(kind, end, "LEFT_SHIFT", "RELEASE")
    yield from mouse(kind, end, "LEFTMOUSE", "RELEASE")


def limits(ob: bpy.types.Object) -> list[float]:
    """Values of its filters."""
    return [getattr(ob.gscore, name) for name in LIMITS]


def undo() -> None:
    """Undo the last step."""
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window, area=area(), region=region()):
        bpy.ops.ed.undo()


def together(wall: bpy.types.Object) -> Iterator[object]:
    """Both handles of the sizes at one place, dragged either way."""
    seen["together"] = []
    for end in (0.8, 0.3):
        wall.gscore.size_min = wall.gscore.size_max = 0.0316
        yield at_rest
        yield from drag(SIZE, 0.5, end)
        seen["together"].append(limits(wall))


def meanwhile(wall: bpy.types.Object) -> Iterator[object]:
    """Other splats, another mesh, and an empty scene in the middle of a drag."""
    other = lab.add(bpy.context.scene, lab.wall(-5.0, (0.1, 0.1, 0.1)), "other")
    other.gscore.opacity_min = 0.7
    bpy.context.view_layer.objects.active = wall
    yield at_rest
    yield from take(OPACITY, 0.0)
    yield from mouse(OPACITY, 0.3, "MOUSEMOVE", "NOTHING")
    bpy.context.view_layer.objects.active = other
    yield PAUSE
    yield from mouse(OPACITY, 0.5, "MOUSEMOVE", "NOTHING")
    seen["two"] = [wall.gscore.opacity_min, other.gscore.opacity_min]
    yield from mouse(OPACITY, 0.5, "ESC", "PRESS")
    yield from mouse(OPACITY, 0.5, "LEFTMOUSE", "RELEASE")
    seen["two_after"] = [wall.gscore.opacity_min, other.gscore.opacity_min]
    yield from take(OPACITY, 0.7)
    yield from mouse(OPACITY, 0.6, "MOUSEMOVE", "NOTHING")
    bpy.context.window_manager.gscore_histograms = False
    yield PAUSE
    yield from mouse(OPACITY, 0.6, "ESC", "PRESS")
    yield from mouse(OPACITY, 0.6, "LEFTMOUSE", "RELEASE")
    seen["switched_off"] = other.gscore.opacity_min
    bpy.context.window_manager.gscore_histograms = True
    yield 0.5
    yield from take(OPACITY, 0.7)
    yield from mouse(OPACITY, 0.6, "MOUSEMOVE", "NOTHING")
    bpy.data.objects.remove(other)
    yield PAUSE
    yield from mouse(OPACITY, 0.4, "MOUSEMOVE", "NOTHING")
    yield from mouse(OPACITY, 0.4, "LEFTMOUSE", "RELEASE")
    seen["deleted"] = limits(wall)


def story() -> Iterator[object]:
    """The events; a yield returns control to Blender (`ScriptRunner`)."""
    clear()
    look_down()
    splats = lab.wall(0.0, (0.8, 0.4, 0.2))
    shares = np.linspace(0.02, 0.98, len(splats.opacities))
    splats.opacities[:] = np.log(shares / (1 - shares))
    splats.scales[:] = np.log(np.geomspace(0.01, 0.1, len(shares)))[:, None]
    wall = lab.add(bpy.context.scene, splats, "wall")
    bpy.context.view_layer.objects.active = wall
    bpy.ops.ed.undo_push(message="wall")
    space().show_gizmo = True
    for switch in ("show_gizmo_navigate", "show_gizmo_tool", "show_gizmo_context"):
        setattr(space(), switch, False)
    yield at_rest
    save_screenshot(FOLDER / "off.png")
    bpy.context.window_manager.gscore_histograms = True
    yield at_rest
    yield 0.5
    save_screenshot(FOLDER / "on.png")
    seen["boxes"] = {kind: box(kind) for kind in (OPACITY, SIZE)}
    yield from drag(OPACITY, 0.0, 0.5)
    yield at_rest
    seen["dragged"] = limits(wall)
    save_screenshot(FOLDER / "dragged.png")
    wall.gscore.apply_filters_to_render = False  # which is of renders
    yield 0.5
    yield at_rest
    save_screenshot(FOLDER / "not_in_renders.png")
    wall.gscore.apply_filters_to_render = True
    yield at_rest
    yield from drag(OPACITY, 0.5, 0.75, fine=True)
    seen["fine"] = limits(wall)
    undo()
    yield at_rest
    wall = bpy.data.objects["wall"]
    seen["undone"] = limits(wall)
    yield from take(OPACITY, 0.5)
    yield from mouse(OPACITY, 0.9, "MOUSEMOVE", "NOTHING")
    seen["while"] = limits(wall)
    yield from mouse(OPACITY, 0.9, "ESC", "PRESS")
    yield from mouse(OPACITY, 0.9, "LEFTMOUSE", "RELEASE")
    seen["cancelled"] = limits(wall)
    yield from drag(SIZE, 1.0, 0.7)
    yield from drag(SIZE, 0.2, 0.2)  # a click moves the nearest handle
    yield at_rest
    seen["sizes"] = limits(wall)
    save_screenshot(FOLDER / "sizes.png")
    yield from drag(SIZE, 0.7, 1.05)
    yield from drag(SIZE, 0.2, 1.2)
    seen["ends"] = limits(wall)
    yield from together(wall)
    bpy.ops.gscore.reset_filters()
    yield from meanwhile(wall)
    bpy.context.window_manager.gscore_histograms = False
    bpy.context.view_layer.objects.active = wall
    yield at_rest
    yield 0.5
    save_screenshot(FOLDER / "off_again.png")


ScriptRunner(story(), write_results(FOLDER, seen))
