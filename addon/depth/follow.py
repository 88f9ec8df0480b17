"""The part of depth jobs in the beat, and their end with the end of Blender."""

import atexit

from ..job import lookups
from ..process import beat
from .registry import JOBS


def _collect() -> bool:
    stale = False
    for job in JOBS.jobs():
        if job.poll():
            stale = True
            if job.ended:
                lookups.captures.expire()
                lookups.networks.expire()
    return stale


_FOLLOWER = beat.Follower(_collect, JOBS.waits)


def on_register() -> None:
    """Follow depth jobs, and let go of them when Blender ends."""
    beat.FOLLOWERS.append(_FOLLOWER)
    atexit.register(JOBS.leave_all)


def on_unregister() -> None:
    """Let go of all of them: predictions end after a view."""
    beat.FOLLOWERS.remove(_FOLLOWER)
    atexit.unregister(JOBS.leave_all)
    JOBS.leave_all()
