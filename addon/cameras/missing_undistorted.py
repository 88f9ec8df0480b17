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
"""Seconds after which it is looked up again."""
_NEVER = 1e9
"""Seconds that no Blender runs for: what was looked up grows old here alone."""


@dataclass(frozen=True)
class Lack:
    """What some cameras lack."""

    copies: tuple[Path, ...] = ()
    """Of the photos that have to be straightened."""
    problems: tuple[str, ...] = ()
    """Of cameras that cannot be looked at, sentences."""


def lack_of(cameras: Iterable[bpy.types.Object]) -> Lack:
    """What cameras lack; asks the disk."""
    return _looked(*_taken(cameras))


class Lacking:
    """What captures lack, by the session number of their empty; used on the main thread."""

    def __init__(self) -> None:
        self._taken: dict[int, tuple[list[StraightBackground], list[str]]] = {}
        self._times: dict[int, float] = {}
        self._lookup: Lookup[int, Lack] = Lookup(
            lambda uid: _looked(*self._taken.get(uid, ((), ()))), max_age=_NEVER
        )

    def of(self, root: bpy.types.Object, cameras: Iterable[bpy.types.Object]) -> Lack:
        """What is known by now of the cameras of a capture."""
        uid, now = root.session_uid, time.monotonic()
        if not self.busy and now - self._times.get(uid, float("-inf")) > _AGE:
            self._taken[uid], self._times[uid] = _taken(cameras), now
            self._lookup.expire()
        found = self._lookup.get(uid)[0] or Lack()
        poll_timer.ensure()
        return found

    def expire(self) -> None:
        """Look anew when it is asked for next."""
        self._times.clear()

    def clear(self) -> None:
        """Forget everything: another file is open."""
        self._times.clear()
        self._taken.clear()

    def collect(self) -> bool:
        """Take in what threads have found; whether that was anything new."""
        return self._lookup.collect()

    @property
    def busy(self) -> bool:
        """Whether something is being looked up."""
        return self._lookup.busy


def _taken(cameras: Iterable[bpy.types.Object]) -> tuple[list[StraightBackground], list[str]]:
    """What Blender knows of the backgrounds of cameras, and problems with them."""
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
    """What the disk says of them; no bpy."""
    copies = (background.lacks() for background in backgrounds)
    return Lack(tuple(copy for copy in copies if copy is not None), tuple(problems))
