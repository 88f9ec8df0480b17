"""Incremental removal of unused datablocks while Blender is idle.

Removing thousands of datablocks in one call blocks Blender for 100 ms and more.
"""

from collections.abc import Iterator

import bpy
from bpy.app.handlers import persistent

_INTERVAL = 0.01
_pending: list[Iterator[None]] = []


def clear(steps: Iterator[None]) -> None:
    """Queue short steps for Blender's timer. Without a window timers never run, so `finish` or
    `clearing` runs them."""
    _pending.append(steps)
    if not bpy.app.background and not bpy.app.timers.is_registered(_tick):
        bpy.app.timers.register(_tick, first_interval=_INTERVAL)


def clearing() -> Iterator[str]:
    """Remaining removals as steps, for work that needs the freed names."""
    while _step():
        yield "Removing what is no longer needed"


@persistent
def finish(*_: object) -> None:
    """Run all remaining removals: before a file is saved or closed, and for scripts."""
    for _ in clearing():
        pass


def _step() -> bool:
    """Run a step; True if there was one."""
    if not _pending:
        return False
    steps = _pending[0]
    try:
        next(steps)
    except StopIteration:
        _pending.remove(steps)
    except BaseException:
        _pending.remove(steps)  # else it would fail again and again
        raise
    return True


def _tick() -> float | None:
    if bpy.app.is_job_running("RENDER"):
        return _INTERVAL
    return _INTERVAL if _step() else None


HANDLERS = {"save_pre": finish, "load_pre": finish}


def on_unregister() -> None:
    """Run all remaining removals, because the timer ends."""
    finish()
