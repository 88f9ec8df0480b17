"""The part of searches in the beat, and their end with the end of Blender."""

from ..job import lookups
from ..job.launch import Following
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


_FOLLOWING = Following([beat.Follower(_collect, _waits)], JOBS.leave_all)
on_register, on_unregister = _FOLLOWING.on_register, _FOLLOWING.on_unregister
