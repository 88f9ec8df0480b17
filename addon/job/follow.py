"""A training's part of the beat, and its end with the end of Blender."""

from ..process import beat
from . import display, lookups, registry
from .launch import Following


def _collect() -> bool:
    """A beat does one thing that may take milliseconds: read lines, show a picture, hand splats."""
    stale = False
    for job in registry.jobs():
        if job.poll():
            stale = True
            if job.state.ended:
                lookups.runs.expire()
                lookups.depth_runs.expire()
        else:
            stale |= display.update(job)
    return stale


def _waits() -> bool:
    return any(display.waits(job) for job in registry.jobs())


_FOLLOWING = Following(
    [
        beat.Follower(_collect, _waits, display.filling),
        beat.Follower(lookups.collect, lookups.busy),
    ],
    registry.leave_all,
)
on_register, on_unregister = _FOLLOWING.on_register, _FOLLOWING.on_unregister
