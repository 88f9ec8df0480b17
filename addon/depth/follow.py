"""The part of depth jobs in the beat, and their end with the end of Blender."""

from ..job import lookups
from ..job.launch import Following
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


_FOLLOWING = Following([beat.Follower(_collect, JOBS.waits)], JOBS.leave_all)
on_register, on_unregister = _FOLLOWING.on_register, _FOLLOWING.on_unregister
