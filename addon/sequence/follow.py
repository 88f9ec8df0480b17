"""Sequence poller: updates of jobs by the poll timer, and their end when Blender quits."""

from ..process import poll_timer
from ..training.launch import following_verb
from . import job_registry

_LOOKUPS = poll_timer.Poller(job_registry.collect, job_registry.busy)
_FOLLOWING = following_verb(job_registry.JOBS, job_registry.trained.expire)


def on_register() -> None:
    """Start to poll jobs and lookups."""
    _FOLLOWING.on_register()
    poll_timer.POLLERS.append(_LOOKUPS)


def on_unregister() -> None:
    """Stop polling."""
    poll_timer.POLLERS.remove(_LOOKUPS)
    _FOLLOWING.on_unregister()
