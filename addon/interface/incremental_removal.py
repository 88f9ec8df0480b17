"""Incremental removal of unused datablocks while Blender is idle.

Blender takes a hundred milliseconds and more to remove thousands of datablocks at once.
"""

from collections.abc import Iterator

import bpy
from bpy.app.handlers import persistent

_INTERVAL = 0.01
_pending: list[Iterator[None]] = []


def clear(steps: Iterator[None]) -> None:
    """Have steps done, a short piece each, on Blender's timer. Without a window timers never run:
    then `finish` does them, or `clearing`."""
    _pending.append(steps)
    if not bpy.app.background and not bpy.app.timers.is_registered(_beat):
        bpy.app.timers.register(_beat, first_interval=_INTERVAL)


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
        _pending.remove(steps)  # or it would fail for ever
        raise
    return True


def _beat() -> float | None:
    if bpy.app.is_job_running("RENDER"):
        return _INTERVAL
    return _INTERVAL if _step() else None


HANDLERS = {"save_pre": finish, "load_pre": finish}


def on_unregister() -> None:
    """Leave nothing: Blender calls nobody any more."""
    finish()
