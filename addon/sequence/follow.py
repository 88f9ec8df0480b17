"""The part of sequences' trainings in the beat, and their end with the end of Blender."""

from ..job.launch import following_verb
from ..process import beat
from . import registry

_LOOKUPS = beat.Follower(registry.collect, registry.busy)
_FOLLOWING = following_verb(registry.JOBS, registry.trained.expire)


def on_register() -> None:
    """Follow them."""
    _FOLLOWING.on_register()
    beat.FOLLOWERS.append(_LOOKUPS)


def on_unregister() -> None:
    """Let go of them."""
    beat.FOLLOWERS.remove(_LOOKUPS)
    _FOLLOWING.on_unregister()
