"""Script helpers inside a Blender with a window: its 3D view, and scripts run in steps.

Import this after enabling the add-on.
"""

import json
import subprocess
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path

import addon_utils
import bpy
from mathutils import Quaternion

from addon.live import draw_handler


def area() -> bpy.types.Area:
    """The area of the 3D view."""
    screen = bpy.context.window_manager.windows[0].screen
    return next(a for a in screen.areas if a.type == "VIEW_3D")


def space() -> bpy.types.SpaceView3D:
    """The 3D view."""
    return area().spaces.active


def region() -> bpy.types.Region:
    """Its main region."""
    return next(r for r in area().regions if r.type == "WINDOW")


def at_rest() -> bool:
    """Whether the view shows the complete current scene, live or as the engine's exact picture."""
    if region().as_pointer() in draw_handler.viewport.EXACT:
        return True
    view = draw_handler.view_of(region())
    return view is not None and view.complete and not view.waits


def clear() -> None:
    """Remove all objects, and all overlays of the view except splats."""
    for ob in list(bpy.data.objects):
        bpy.data.objects.remove(ob)
    space().show_region_ui = space().show_region_header = False
    space().show_region_toolbar = space().show_gizmo = False
    space().overlay.show_overlays = True
    for switch in ("show_floor", "show_axis_x", "show_axis_y", "show_cursor", "show_text"):
        setattr(space().overlay, switch, False)


def look_down() -> bpy.types.RegionView3D:
    """Set the 3D view straight down to the origin from a height of 4, in perspective."""
    view = space().region_3d
    view.view_rotation, view.view_distance = Quaternion((1, 0, 0, 0)), 4.0
    view.view_location, view.view_perspective = (0, 0, 0), "PERSP"
    return view


def send(key: str, value: str = "PRESS", right: int = 0, up: int = 0, **held: bool) -> None:
    """Simulate an event; Blender needs `--enable-event-simulate`.

    Args:
        key: Blender's event type.
        value: Blender's event value.
        right: Position of the mouse to the right of the view's middle, pixels.
        up: Position above it, pixels.
        held: Pressed modifier keys.
    """
    shown = region()
    x, y = shown.x + shown.width // 2 + right, shown.y + shown.height // 2 + up
    bpy.context.window_manager.windows[0].event_simulate(key, value, x=x, y=y, **held)


def save_screenshot(file: Path) -> None:
    """Write a screenshot."""
    subprocess.run(["import", "-window", "root", str(file)], check=True)


def write_results(folder: Path, seen: dict) -> Callable[[str], None]:
    """Callback for the end of a script: writes the results, disables the add-on, quits Blender.

    Args:
        folder: Folder of seen.json.
        seen: Results as strict JSON; errors are appended to the list "log".
    """

    def end(problem: str) -> None:
        if problem:
            seen["log"].append(problem)
        (folder / "seen.json").write_text(json.dumps(seen))
        addon_utils.disable("addon", default_set=True)
        bpy.ops.wm.quit_blender()

    return end


class ScriptRunner:
    """Blender timer that runs a script, given as a generator.

    Each yield returns to Blender, for the yielded number of seconds or until the yielded function
    returns True.
    """

    LONGEST = 60.0
    """Time limit of each wait, s."""
    STEP = 0.1

    def __init__(self, story: Iterator[object], end: Callable[[str], None]) -> None:
        """Start the script soon.

        Args:
            story: The script.
            end: Called once afterwards, with an error message or an empty string.
        """
        self._story, self._end = story, end
        self._condition: object = 0.0
        self._since = time.monotonic()
        bpy.context.preferences.view.show_splash = False
        # persistent, as a script may open another file
        bpy.app.timers.register(self._go_on, first_interval=2.0, persistent=True)

    def _go_on(self) -> float | None:
        """Seconds to the next call."""
        if callable(self._condition) and not self._condition():
            if time.monotonic() - self._since > self.LONGEST:
                return self._end(f"timed out waiting for {self._condition}")
            area().tag_redraw()
            return self.STEP
        try:
            self._condition, self._since = next(self._story), time.monotonic()
        except StopIteration:
            return self._end("")
        except Exception:
            return self._end(traceback.format_exc())
        return self.STEP if callable(self._condition) else float(self._condition)
