"""Missing undistorted copies of captures' backgrounds, for panels: checked in threads, since each
photo needs a disk access.
"""

import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import bpy

from ..interface.lookup import Lookup
from ..interface.option_labels import error_words
from ..process import poll_timer
from .backgrounds import StraightBackground, straight_background

_AGE = 3.0
"""Lifetime of a cached result, seconds."""
_NEVER = 1e9
"""Seconds that no Blender runs for: what was looked up grows old here alone."""


@dataclass(frozen=True)
class Lack:
    """Missing copies of some cameras."""

    copies: tuple[Path, ...] = ()
    """Tasks of the photos to undistort."""
    problems: tuple[str, ...] = ()
    """Errors of unreadable cameras, sentences."""


def lack_of(cameras: Iterable[bpy.types.Object]) -> Lack:
    """Missing copies of cameras; reads the disk."""
    return _looked(*_taken(cameras))


class Lacking:
    """Missing copies of captures by session uid of their empty; main thread only."""

    def __init__(self) -> None:
        self._taken: dict[int, tuple[list[StraightBackground], list[str]]] = {}
        self._times: dict[int, float] = {}
        self._lookup: Lookup[int, Lack] = Lookup(
            lambda uid: _looked(*self._taken.get(uid, ((), ()))), max_age=_NEVER
        )

    def of(self, root: bpy.types.Object, cameras: Iterable[bpy.types.Object]) -> Lack:
        """Cached result for the cameras of a capture."""
        uid, now = root.session_uid, time.monotonic()
        if not self.busy and now - self._times.get(uid, float("-inf")) > _AGE:
            self._taken[uid], self._times[uid] = _taken(cameras), now
            self._lookup.expire()
        found = self._lookup.get(uid)[0] or Lack()
        poll_timer.ensure()
        return found

    def expire(self) -> None:
        """Drop the cached result of a capture."""
        self._times.clear()

    def clear(self) -> None:
        """Drop all results after a file load."""
        self._times.clear()
        self._taken.clear()

    def collect(self) -> bool:
        """Collect results of threads; True if any is new."""
        return self._lookup.collect()

    @property
    def busy(self) -> bool:
        """True while a thread runs."""
        return self._lookup.busy


def _taken(cameras: Iterable[bpy.types.Object]) -> tuple[list[StraightBackground], list[str]]:
    """Backgrounds of cameras as read from bpy, and errors."""
    found, problems = [], []
    for ob in cameras:
        try:
            background = straight_background(ob)
        except ValueError as error:
            problems.append(error_words(error))
            continue
        if background is not None:
            found.append(background)
    return found, problems


def _looked(backgrounds: Iterable[StraightBackground], problems: Iterable[str]) -> Lack:
    """Missing copies on disk; no bpy."""
    copies = (background.lacks() for background in backgrounds)
    return Lack(tuple(copy for copy in copies if copy is not None), tuple(problems))
