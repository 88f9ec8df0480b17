"""Error map poller: updates of errors jobs by the poll timer, and their end when Blender quits."""

from ..training import lookups
from ..training.launch import following_verb
from . import measure_errors
from .errors_job import ErrorsJob
from .job_registry import JOBS


def _wanted(job: ErrorsJob) -> bool:
    return job.wanted


def _hurries(job: ErrorsJob) -> bool:
    return job.filling is not None


_FOLLOWING = following_verb(
    JOBS, lookups.figures.expire, bring_in=measure_errors.bring_in, wanted=_wanted, hurries=_hurries
)
on_register, on_unregister = _FOLLOWING.on_register, _FOLLOWING.on_unregister
