"""Runs inside a Blender with a window: shows splats, takes screenshots, writes down what it saw.

`blender --factory-startup -P tests/window/live_scene.py -- FOLDER PACKAGES...`; PACKAGES are
folders with what Blender's Python lacks. Leaves FOLDER/seen.json and pictures of the screen.
"""

import json
import subprocess
import sys
import traceback
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDER, *PACKAGES = map(Path, sys.argv[sys.argv.index("--") + 1 :])
sys.path[:0] = [str(ROOT), *map(str, PACKAGES)]

import addon_utils  # noqa: E402 - the path comes first
import bpy  # noqa: E402
from mathutils import Quaternion  # noqa: E402

addon_utils.enable("addon", default_set=True, persistent=True)

from addon.live import handler  # noqa: E402
from addon.live.card import Card  # noqa: E402
from tests.addon import splat_scenes as lab  # noqa: E402

COLOR = (0.8, 0.4, 0.2)
seen: dict = {"log": []}


def space() -> bpy.types.SpaceView3D:
    """The 3D view, the largest area there is."""
    return _area().spaces.active


def region() -> bpy.types.Region:
    """Its main region."""
    return next(r for r in _area().regions if r.type == "WINDOW")


def _area() -> bpy.types.Area:
    screen = bpy.context.window_manager.windows[0].screen
    return next(a for a in screen.areas if a.type == "VIEW_3D")


def at_rest() -> bool:
    """Whether the view shows everything as it is now."""
    view = handler.view_of(region())
    return view is not None and view.complete and not view.waits


def screenshot(name: str) -> None:
    """The screen as a file, and where the view is in it."""
    subprocess.run(["import", "-window", "root", str(FOLDER / f"{name}.png")], check=True)


def named(context: bpy.types.Context) -> list[str]:
    """The objects that are drawn live."""
    found = handler.shown(context, context.evaluated_depsgraph_get())
    return sorted(source.ob.name for source in found)


def look() -> list[str]:
    """The same for the view of the window."""
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window, area=_area(), region=region()):
        return named(bpy.context)


def story() -> Iterator[object]:
    """Each yield hands over to Blender, until what is yielded says that it may go on."""
    scene = bpy.context.scene
    for ob in list(bpy.data.objects):
        bpy.data.objects.remove(ob)
    space().show_region_ui = space().show_region_header = False
    space().show_region_toolbar = space().show_gizmo = False
    space().overlay.show_overlays = True
    for switch in ("show_floor", "show_axis_x", "show_axis_y", "show_cursor", "show_text"):
        setattr(space().overlay, switch, False)
    view = space().region_3d
    view.view_rotation, view.view_distance = Quaternion((1, 0, 0, 0)), 4.0
    view.view_location, view.view_perspective = (0, 0, 0), "PERSP"
    wall = lab.add(scene, lab.wall(0.0, COLOR), "wall")
    seen["display"] = wall.gscore.display
    yield at_rest
    yield 1.0
    shown = region()
    seen["middle"] = [shown.x + shown.width // 2, shown.y + shown.height // 2]
    screenshot("wall")
    mesh = bpy.data.meshes.new("plate")
    mesh.from_pydata(
        [(-0.2, -0.2, 0.5), (0.2, -0.2, 0.5), (0.2, 0.2, 0.5), (-0.2, 0.2, 0.5)], [], [(0, 1, 2, 3)]
    )
    plate = bpy.data.objects.new("plate", mesh)
    scene.collection.objects.link(plate)
    yield 1.0
    screenshot("plate_before")
    plate.location.z = -1.0
    yield 1.0
    screenshot("plate_behind")
    other = lab.add(scene, lab.blob(), "blob")
    yield at_rest
    seen["both"] = look()
    other.hide_set(True)
    yield 0.3
    seen["hidden"] = look()
    other.hide_set(False)
    other.gscore.display = "POINTS"
    yield 0.3
    seen["as_points"] = look()
    other.gscore.display = "SPLATS"
    window = bpy.context.window_manager.windows[0]
    for ob in scene.objects:
        ob.select_set(ob == other)
    with bpy.context.temp_override(window=window, area=_area(), region=region()):
        bpy.ops.view3d.localview()
    yield 0.5
    seen["local"] = look()
    with bpy.context.temp_override(window=window, area=_area(), region=region()):
        bpy.ops.view3d.localview()
    space().overlay.show_overlays = False
    view.view_rotation = Quaternion((0, 0, 1), 0.3)
    yield 0.3
    yield at_rest
    screenshot("both")
    scene.render.engine = "GSCORE_SPLATS"
    scene.view_settings.view_transform = "Standard"
    space().shading.type = "RENDERED"
    plate.hide_set(True)
    yield lambda: region().as_pointer() in handler.viewport.EXACT
    yield 1.0
    screenshot("exact")
    handler.viewport.EXACT.clear()
    space().shading.type = "SOLID"
    handler._state.card, init = None, Card.__init__
    Card.__init__ = _refusing
    _area().tag_redraw()
    yield 1.0
    Card.__init__ = init
    seen["refused"] = handler.problem_of(region())


def _refusing(self: Card) -> None:
    raise Exception("a driver's word")


class _Runner:
    """Goes on with the story when what it waits for is there."""

    LONGEST = 60.0
    STEP = 0.1

    def __init__(self) -> None:
        self.story = story()
        self.wish: object = 0.0
        self.waited = 0.0

    def __call__(self) -> float | None:
        """Blender's timer; seconds to the next call."""
        if callable(self.wish) and not self.wish() and self.waited < self.LONGEST:
            self.waited += self.STEP
            _area().tag_redraw()
            return self.STEP
        if self.waited >= self.LONGEST:
            seen["log"].append("waited in vain")
        try:
            self.wish, self.waited = next(self.story), 0.0
        except StopIteration:
            return _end()
        except Exception:
            seen["log"].append(traceback.format_exc())
            return _end()
        return self.STEP if callable(self.wish) else float(self.wish)


def _end() -> None:
    found = handler.view_of(region())
    seen["seconds"] = None if found is None else found.seconds
    (FOLDER / "seen.json").write_text(json.dumps(seen))
    addon_utils.disable("addon", default_set=True)
    bpy.ops.wm.quit_blender()


bpy.context.preferences.view.show_splash = False
bpy.app.timers.register(_Runner(), first_interval=2.0)
