"""Poll timer: collects results of processes and threads on Blender's main thread.

Blender calls `poll` several times a second while results are pending. Without a window timers
never run: scripts call `poll` themselves, or a function that waits.
"""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass

import bpy
from bpy.app.handlers import persistent

from .pace import Pace

INTERVAL = 0.1
"""Seconds between two beats."""
FAST = 0.01
"""The same while splats are handed to Blender bit by bit."""
REDRAW = 0.4
"""Seconds between two redraws: the viewport behind a sidebar is drawn with it."""
AFTER_ERROR = 5.0
"""Seconds to the next beat after an error of our own."""

_log = logging.getLogger(__name__)


def _no() -> bool:
    return False


@dataclass(frozen=True)
class Poller:
    """What is done at a beat."""

    collect: Callable[[], bool]
    """Does a small piece of what there is to do; says whether panels have to be drawn anew."""
    waits: Callable[[], bool] = _no
    """Whether anything is under way."""
    hurries: Callable[[], bool] = _no
    """Whether the next beat should come soon."""


FOLLOWERS: list[Poller] = []
"""In the order in which they were registered; a later one sees what an earlier one took in."""


@dataclass
class _Screen:
    """What panels show."""

    changed: bool = False
    """Whether the last tick has changed it."""
    stale: bool = False
    """Whether it is not what there is to show."""
    drawn: float = 0.0
    """Time of the last redraw, monotonic seconds."""


_screen = _Screen()
_pace = Pace()


def poll() -> bool:
    """Do a small piece of whatever there is to do; whether anything is under way."""
    _screen.changed = False
    for follower in FOLLOWERS:
        _screen.changed |= follower.collect()
    _screen.stale |= _screen.changed
    if _screen.stale and time.monotonic() - _screen.drawn > REDRAW:
        redraw()
    waits = any(follower.waits() for follower in FOLLOWERS)
    return waits or (_screen.stale and not bpy.app.background)


def ensure() -> None:
    """Have `poll` called from now on, until there is nothing to wait for."""
    if not bpy.app.background and not bpy.app.timers.is_registered(_beat):
        bpy.app.timers.register(_beat, first_interval=INTERVAL, persistent=True)


def redraw() -> None:
    """Draw the sidebars of 3D views, and preferences, anew."""
    _screen.stale, _screen.drawn = False, time.monotonic()
    manager = bpy.context.window_manager
    areas = [area for window in manager.windows for area in window.screen.areas]
    for area in areas:
        wanted = {"VIEW_3D": "UI", "PREFERENCES": "WINDOW"}.get(area.type)
        for region in area.regions:
            if region.type == wanted:
                region.tag_redraw()


def _beat() -> float | None:
    _pace.begin()
    interval = _go_on()
    _pace.end(interval)
    return interval


def _go_on() -> float | None:
    """As many ticks as the pace allows; seconds to the next."""
    try:
        while True:
            waits, hurries = poll(), any(follower.hurries() for follower in FOLLOWERS)
            if not (waits and hurries and _pace.more(did=_screen.changed)):
                break
    except Exception:  # Blender would never call again, and a training would seem to stand still
        _log.exception("An error in the add-on; please report it.")
        return AFTER_ERROR
    if not waits:
        return None
    return FAST if hurries else INTERVAL


@persistent
def _file_loaded(*_: object) -> None:
    """What is under way belongs to the session: the file that is open now may be its own."""
    ensure()


HANDLERS = {"load_post": _file_loaded}


def on_unregister() -> None:
    """Beat no more."""
    if bpy.app.timers.is_registered(_beat):
        bpy.app.timers.unregister(_beat)
