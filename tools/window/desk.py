"""Script helpers inside a Blender with a window: its 3D view, and steps run one by one.

The add-on is there before this is imported.
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

from addon.live import handler


def area() -> bpy.types.Area:
    """The area of the 3D view, the largest there is."""
    screen = bpy.context.window_manager.windows[0].screen
    return next(a for a in screen.areas if a.type == "VIEW_3D")


def space() -> bpy.types.SpaceView3D:
    """The 3D view."""
    return area().spaces.active


def region() -> bpy.types.Region:
    """Its main region."""
    return next(r for r in area().regions if r.type == "WINDOW")


def at_rest() -> bool:
    """Whether the view shows everything as it is now, live or in the engine's exact picture."""
    if region().as_pointer() in handler.viewport.EXACT:
        return True
    view = handler.view_of(region())
    return view is not None and view.complete and not view.waits


def clear() -> None:
    """Nothing in the scene, and nothing over the view but splats."""
    for ob in list(bpy.data.objects):
        bpy.data.objects.remove(ob)
    space().show_region_ui = space().show_region_header = False
    space().show_region_toolbar = space().show_gizmo = False
    space().overlay.show_overlays = True
    for switch in ("show_floor", "show_axis_x", "show_axis_y", "show_cursor", "show_text"):
        setattr(space().overlay, switch, False)


def look_down() -> bpy.types.RegionView3D:
    """The 3D view, which looks straight down at the origin from 4 above it, in perspective."""
    view = space().region_3d
    view.view_rotation, view.view_distance = Quaternion((1, 0, 0, 0)), 4.0
    view.view_location, view.view_perspective = (0, 0, 0), "PERSP"
    return view


def send(key: str, value: str = "PRESS", right: int = 0, up: int = 0, **held: bool) -> None:
    """An event, for which Blender needs `--enable-event-simulate`.

    Args:
        key: What it is of, in Blender's word.
        value: The same.
        right: Pixels of the mouse to the right of the view's middle.
        up: Above it.
        held: Keys that are down meanwhile.
    """
    shown = region()
    x, y = shown.x + shown.width // 2 + right, shown.y + shown.height // 2 + up
    bpy.context.window_manager.windows[0].event_simulate(key, value, x=x, y=y, **held)


def shoot(file: Path) -> None:
    """The screen as a file."""
    subprocess.run(["import", "-window", "root", str(file)], check=True)


def leaving(folder: Path, seen: dict) -> Callable[[str], None]:
    """The end of a story: what was seen goes into a file, the add-on off, and Blender ends.

    Args:
        folder: Gets seen.json.
        seen: Strict JSON; "log" is a list, and gets what went wrong.
    """

    def end(problem: str) -> None:
        if problem:
            seen["log"].append(problem)
        (folder / "seen.json").write_text(json.dumps(seen))
        addon_utils.disable("addon", default_set=True)
        bpy.ops.wm.quit_blender()

    return end


class Teller:
    """Goes on with a story when what it waits for is there; a timer of Blender's.

    Each yield of the story hands over to Blender: for seconds, or until what is yielded says that
    it may go on.
    """

    LONGEST = 60.0
    """Seconds that a story waits for anything."""
    STEP = 0.1

    def __init__(self, story: Iterator[object], end: Callable[[str], None]) -> None:
        """Begin soon.

        Args:
            story: What happens.
            end: Called once after it, with what went wrong or an empty string.
        """
        self._story, self._end = story, end
        self._wish: object = 0.0
        self._since = time.monotonic()
        bpy.context.preferences.view.show_splash = False
        # a story may open another file
        bpy.app.timers.register(self._go_on, first_interval=2.0, persistent=True)

    def _go_on(self) -> float | None:
        """Seconds to the next call."""
        if callable(self._wish) and not self._wish():
            if time.monotonic() - self._since > self.LONGEST:
                return self._end(f"waited in vain for {self._wish}")
            area().tag_redraw()
            return self.STEP
        try:
            self._wish, self._since = next(self._story), time.monotonic()
        except StopIteration:
            return self._end("")
        except Exception:
            return self._end(traceback.format_exc())
        return self.STEP if callable(self._wish) else float(self._wish)
