"""Depth poller: updates of depth jobs by the poll timer, and their end when Blender quits."""

from ..training import lookups
from ..training.launch import following_verb
from .job_registry import JOBS


def _ended() -> None:
    lookups.captures.expire()
    lookups.networks.expire()


_FOLLOWING = following_verb(JOBS, _ended)
on_register, on_unregister = _FOLLOWING.on_register, _FOLLOWING.on_unregister
