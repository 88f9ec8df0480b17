"""SfM poller: updates of SfM jobs by the poll timer, and their end when Blender quits."""

from ..training import lookups
from ..training.launch import following_verb
from . import find_cameras
from .job import SearchJob
from .job_registry import JOBS


def _wanted(job: SearchJob) -> bool:
    return bool(job.wanted)


def _hurries(job: SearchJob) -> bool:
    return job.coming is not None


_FOLLOWING = following_verb(
    JOBS, lookups.captures.expire, bring_in=find_cameras.bring_in, wanted=_wanted, hurries=_hurries
)
on_register, on_unregister = _FOLLOWING.on_register, _FOLLOWING.on_unregister
