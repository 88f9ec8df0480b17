"""The beat that takes in what trainings and searches have found, in Blender's main thread.

Blender calls `tick` several times a second while there is something to wait for. Without a window
timers never run: scripts call `tick`, or `training.wait_for`, themselves.
"""

import atexit
import logging
import time
from collections.abc import Callable

import bpy
from bpy.app.handlers import persistent

from .. import preferences
from ..job import display, lookups, registry
from ..python import setup

INTERVAL = 0.1
"""Seconds between two beats."""
FAST = 0.01
"""The same while splats are handed to Blender bit by bit."""
REDRAW = 0.4
"""Seconds between two redraws: the viewport behind a sidebar is drawn with it."""

FOLLOWERS: list[Callable[[], bool]] = []
"""Called at each beat after all news was taken in; they say whether panels have to be redrawn."""

AFTER_ERROR = 5.0
"""The same after an error of our own."""

_log = logging.getLogger(__name__)
_stale = False
_drawn = 0.0


def tick() -> bool:
    """Do a small piece of whatever there is to do; whether anything is under way.

    A beat does one thing that may take milliseconds: reading lines, or showing a picture, or
    handing splats to Blender.
    """
    global _stale
    for job in registry.jobs():
        if job.poll():
            _stale = True
            if job.state.ended:
                lookups.runs.expire()
                lookups.depth_runs.expire()
        else:
            _stale |= display.update(job)
    for depth in registry.depth_jobs():
        if depth.poll():
            _stale = True
            if depth.ended:
                lookups.captures.expire()
    _stale |= lookups.collect()
    _stale |= setup.collect(preferences.get())
    for follow in FOLLOWERS:
        _stale |= follow()
    if _stale and time.monotonic() - _drawn > REDRAW:
        redraw()
    waits = setup.busy() or lookups.busy() or any(display.waits(job) for job in registry.jobs())
    waits |= any(not depth.ended for depth in registry.depth_jobs())
    return waits or (_stale and not bpy.app.background)


def ensure() -> None:
    """Have `tick` called from now on, until there is nothing to wait for."""
    if not bpy.app.background and not bpy.app.timers.is_registered(_beat):
        bpy.app.timers.register(_beat, first_interval=INTERVAL, persistent=True)


def redraw() -> None:
    """Draw the sidebars of 3D views, and preferences, anew."""
    global _stale, _drawn
    _stale, _drawn = False, time.monotonic()
    manager = bpy.context.window_manager
    areas = [area for window in manager.windows for area in window.screen.areas]
    for area in areas:
        wanted = {"VIEW_3D": "UI", "PREFERENCES": "WINDOW"}.get(area.type)
        for region in area.regions:
            if region.type == wanted:
                region.tag_redraw()


def _beat() -> float | None:
    try:
        waits = tick()
    except Exception:  # Blender would never call again, and a training would seem to stand still
        _log.exception("An error in the add-on; please report it.")
        return AFTER_ERROR
    if not waits:
        return None
    return FAST if display.filling() else INTERVAL


@persistent
def _file_loaded(*_: object) -> None:
    """A job belongs to the session: the file that is open now may be its own."""
    if registry.jobs() or registry.depth_jobs():
        ensure()


def register() -> None:
    """Follow the loading of files, and the end of Blender."""
    bpy.app.handlers.load_post.append(_file_loaded)
    atexit.register(registry.leave_all)


def unregister() -> None:
    """Let go of all jobs, each of which ends by itself."""
    if bpy.app.timers.is_registered(_beat):
        bpy.app.timers.unregister(_beat)
    bpy.app.handlers.load_post.remove(_file_loaded)
    atexit.unregister(registry.leave_all)
    registry.leave_all()
