"""Sequence poller: updates of jobs by the poll timer, and their end when Blender quits."""

from ..process import poll_timer
from ..training.launch import following_verb
from . import registry

_LOOKUPS = poll_timer.Poller(registry.collect, registry.busy)
_FOLLOWING = following_verb(registry.JOBS, registry.trained.expire)


def on_register() -> None:
    """Follow them."""
    _FOLLOWING.on_register()
    poll_timer.POLLERS.append(_LOOKUPS)


def on_unregister() -> None:
    """Let go of them."""
    poll_timer.POLLERS.remove(_LOOKUPS)
    _FOLLOWING.on_unregister()
