"""The part of searches in the beat, and their end with the end of Blender."""

import atexit

from ..job import lookups
from ..process import beat
from . import work
from .registry import JOBS


def _collect() -> bool:
    stale = False
    for job in JOBS.jobs():
        if job.poll():
            stale = True
            if job.ended:
                lookups.captures.expire()
        else:
            stale |= work.bring_in(job)
    return stale


def _waits() -> bool:
    return JOBS.waits() or any(job.wanted for job in JOBS.jobs())


_FOLLOWER = beat.Follower(_collect, _waits)


def on_register() -> None:
    """Follow searches, and let go of them when Blender ends."""
    beat.FOLLOWERS.append(_FOLLOWER)
    atexit.register(JOBS.leave_all)


def on_unregister() -> None:
    """Let go of all of them."""
    beat.FOLLOWERS.remove(_FOLLOWER)
    atexit.unregister(JOBS.leave_all)
    JOBS.leave_all()
