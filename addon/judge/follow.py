"""The part of measurings in the beat, and their end with the end of Blender."""

from ..job import lookups
from ..job.launch import following_verb
from . import work
from .job import ErrorsJob
from .registry import JOBS


def _wanted(job: ErrorsJob) -> bool:
    return job.wanted


def _hurries(job: ErrorsJob) -> bool:
    return job.filling is not None


_FOLLOWING = following_verb(
    JOBS, lookups.figures.expire, bring_in=work.bring_in, wanted=_wanted, hurries=_hurries
)
on_register, on_unregister = _FOLLOWING.on_register, _FOLLOWING.on_unregister
