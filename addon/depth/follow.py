"""The part of depth jobs in the beat, and their end with the end of Blender."""

import atexit

from ..job import lookups
from ..process import beat
from . import registry


def _collect() -> bool:
    stale = False
    for job in registry.jobs():
        if job.poll():
            stale = True
            if job.ended:
                lookups.captures.expire()
    return stale


def _waits() -> bool:
    return any(not job.ended for job in registry.jobs())


_FOLLOWER = beat.Follower(_collect, _waits)


def on_register() -> None:
    """Follow depth jobs, and let go of them when Blender ends."""
    beat.FOLLOWERS.append(_FOLLOWER)
    atexit.register(registry.leave_all)


def on_unregister() -> None:
    """Let go of all of them."""
    beat.FOLLOWERS.remove(_FOLLOWER)
    atexit.unregister(registry.leave_all)
    registry.leave_all()
