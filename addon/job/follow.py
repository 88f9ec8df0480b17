"""A training's part of the beat, and its end with the end of Blender."""

import atexit

from ..process import beat
from . import display, lookups, registry


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


_FOLLOWERS = (
    beat.Follower(_collect, _waits, display.filling),
    beat.Follower(lookups.collect, lookups.busy),
)


def on_register() -> None:
    """Follow trainings, and let go of them when Blender ends."""
    beat.FOLLOWERS.extend(_FOLLOWERS)
    atexit.register(registry.leave_all)


def on_unregister() -> None:
    """Let go of all trainings: each writes a checkpoint and ends."""
    for follower in _FOLLOWERS:
        beat.FOLLOWERS.remove(follower)
    atexit.unregister(registry.leave_all)
    registry.leave_all()
