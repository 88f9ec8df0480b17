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

from .incremental_tasks import Pace

INTERVAL = 0.1
"""Interval of the timer, seconds."""
FAST = 0.01
"""Interval while splats are written to Blender in steps, seconds."""
REDRAW = 0.4
"""Seconds between two redraws: redrawing a sidebar also redraws the viewport behind it."""
AFTER_ERROR = 5.0
"""Delay after an error in the add-on, seconds."""

_log = logging.getLogger(__name__)


def _no() -> bool:
    return False


@dataclass(frozen=True)
class Poller:
    """Work of the timer."""

    collect: Callable[[], bool]
    """Runs a short step; returns True if panels need a redraw."""
    waits: Callable[[], bool] = _no
    """True while work is pending."""
    is_urgent: Callable[[], bool] = _no
    """True if the next step should follow soon."""


POLLERS: list[Poller] = []
"""Pollers in order of registration; later ones receive the results of earlier ones."""


@dataclass
class _Screen:
    """Redraw state of panels."""

    changed: bool = False
    """True if the last tick changed the panels' contents."""
    stale: bool = False
    """True if the panels are out of date."""
    drawn: float = 0.0
    """Time of the last redraw, monotonic seconds."""


_screen = _Screen()
_pace = Pace()


def poll() -> bool:
    """Run a short step of all pending work; True while work is pending."""
    _screen.changed = False
    for poller in POLLERS:
        _screen.changed |= poller.collect()
    _screen.stale |= _screen.changed
    if _screen.stale and time.monotonic() - _screen.drawn > REDRAW:
        redraw()
    waits = any(poller.waits() for poller in POLLERS)
    return waits or (_screen.stale and not bpy.app.background)


def ensure() -> None:
    """Start the timer that calls `poll` until no work is pending."""
    if not bpy.app.background and not bpy.app.timers.is_registered(_tick):
        bpy.app.timers.register(_tick, first_interval=INTERVAL, persistent=True)


def redraw() -> None:
    """Redraw the sidebars of 3D views and the preferences."""
    _screen.stale, _screen.drawn = False, time.monotonic()
    manager = bpy.context.window_manager
    areas = [area for window in manager.windows for area in window.screen.areas]
    for area in areas:
        kind = {"VIEW_3D": "UI", "PREFERENCES": "WINDOW"}.get(area.type)
        for region in area.regions:
            if region.type == kind:
                region.tag_redraw()


def _tick() -> float | None:
    _pace.begin()
    interval = _poll_within_pace()
    _pace.end(interval)
    return interval


def _poll_within_pace() -> float | None:
    """Poll as often as the pace allows; seconds to the next call, None: none."""
    try:
        while True:
            waits, is_urgent = poll(), any(poller.is_urgent() for poller in POLLERS)
            if not (waits and is_urgent and _pace.more(did=_screen.changed)):
                break
    except Exception:  # else Blender drops the timer, and a training would seem to hang
        _log.exception("An error in the add-on; please report it.")
        return AFTER_ERROR
    if not waits:
        return None
    return FAST if is_urgent else INTERVAL


@persistent
def _file_loaded(*_: object) -> None:
    """Keep pending work across file loads: it belongs to the session."""
    ensure()


HANDLERS = {"load_post": _file_loaded}


def on_unregister() -> None:
    """Stop the timer."""
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
