"""Region training poller: updates of jobs by the poll timer, and their end when Blender quits."""

from ..training import lookups
from ..training.launch import following_verb
from . import train_region
from .job import RegionJob
from .job_registry import JOBS


def _wanted(job: RegionJob) -> bool:
    return job.wanted


_FOLLOWING = following_verb(
    JOBS, lookups.runs.expire, bring_in=train_region.proceed, wanted=_wanted
)
on_register, on_unregister = _FOLLOWING.on_register, _FOLLOWING.on_unregister
