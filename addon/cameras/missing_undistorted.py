"""Missing undistorted copies of captures' backgrounds, for panels; checked in threads, because each
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
from .backgrounds import UndistortedBackground, undistorted_background

_AGE = 3.0
"""Lifetime of a cached result, seconds."""
_NEVER = 1e9
"""Maximum age for `Lookup`, seconds: results expire only here."""


@dataclass(frozen=True)
class MissingCopies:
    """Missing copies of some cameras."""

    copies: tuple[Path, ...] = ()
    """Files of the missing copies."""
    problems: tuple[str, ...] = ()
    """Errors of unreadable cameras, sentences."""


def missing_copies(cameras: Iterable[bpy.types.Object]) -> MissingCopies:
    """Missing copies of cameras; reads the disk."""
    return _check(*_backgrounds(cameras))


class MissingCopiesCache:
    """Missing copies of captures by session uid of their empty; main thread only."""

    def __init__(self) -> None:
        self._inputs: dict[int, tuple[list[UndistortedBackground], list[str]]] = {}
        self._times: dict[int, float] = {}
        self._lookup: Lookup[int, MissingCopies] = Lookup(
            lambda uid: _check(*self._inputs.get(uid, ((), ()))), max_age=_NEVER
        )

    def of(self, root: bpy.types.Object, cameras: Iterable[bpy.types.Object]) -> MissingCopies:
        """Cached result for the cameras of a capture."""
        uid, now = root.session_uid, time.monotonic()
        if not self.busy and now - self._times.get(uid, float("-inf")) > _AGE:
            self._inputs[uid], self._times[uid] = _backgrounds(cameras), now
            self._lookup.expire()
        lack = self._lookup.get(uid)[0] or MissingCopies()
        poll_timer.ensure()
        return lack

    def expire(self) -> None:
        """Check all captures again at their next request."""
        self._times.clear()

    def clear(self) -> None:
        """Drop all results after a file load."""
        self._times.clear()
        self._inputs.clear()

    def collect(self) -> bool:
        """Collect results of threads; True if any is new."""
        return self._lookup.collect()

    @property
    def busy(self) -> bool:
        """True while a thread runs."""
        return self._lookup.busy


def _backgrounds(
    cameras: Iterable[bpy.types.Object],
) -> tuple[list[UndistortedBackground], list[str]]:
    """Backgrounds of cameras as read from bpy, and errors."""
    backgrounds, problems = [], []
    for ob in cameras:
        try:
            background = undistorted_background(ob)
        except ValueError as error:
            problems.append(error_words(error))
            continue
        if background is not None:
            backgrounds.append(background)
    return backgrounds, problems


def _check(backgrounds: Iterable[UndistortedBackground], problems: Iterable[str]) -> MissingCopies:
    """Missing copies on disk; no bpy."""
    copies = (background.missing_copy() for background in backgrounds)
    return MissingCopies(tuple(copy for copy in copies if copy is not None), tuple(problems))
