"""How long a search for cameras takes: told before it, and what is left while it goes on."""

import math
import os
import time
from collections.abc import Callable

FEATURES, MATCHING = "finding features", "comparing photos"
PLACING, ADJUSTING = "placing cameras", "adjusting cameras"
"""Phases that take time, in their order."""

_FIND = 1.0
"""CPU seconds to find features in a megapixel. All of these on cores of an EPYC of 2024, with
captures of 29 to 60 photos; docs/sfm.md has the figures that they come from."""
_PER_MEGAPIXEL = 8000
"""Features in a megapixel; from 3,400 (walls) to 12,300 (grass)."""
_DOUBLED = 1.25
"""Features against those that are kept: some point two ways."""
_VERIFY, _COMPARE = 0.010, 1.2e-5
"""CPU seconds of a pair of photos, and more for each feature of a photo."""
_PLACE, _ADJUST = 5e-5, 4e-5
"""CPU seconds for each feature of all photos."""


def working_cores(threads: int) -> int:
    """How many work, of an option that is 0 for one a core."""
    return threads or os.cpu_count() or 1


def features_of(megapixels: float, most: int) -> float:
    """Features that a photo is expected to have."""
    return min(_PER_MEGAPIXEL * megapixels, _DOUBLED * most)


class Forecast:
    """Seconds of the phases; those done teach how fast this machine is at the moment."""

    def __init__(
        self,
        *,
        megapixels: list[float],
        most: int,
        pairs: int,
        threads: int,
        pace: float = 1.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Begin with photos of which nothing is known but their sizes.

        Args:
            megapixels: Of each photo, as features are looked for.
            most: Features that are kept of a photo.
            pairs: Of photos that are compared.
            threads: 0: one a core.
            pace: Seconds that one of the forecast takes, as an earlier one has learned.
            clock: Seconds.
        """
        self._share = 1.0 / working_cores(threads)
        self._photos, self._pairs, self._clock = len(megapixels), pairs, clock
        self._seconds = {FEATURES: _FIND * sum(megapixels)}
        self._expect(sum(features_of(size, most) for size in megapixels))
        self._phase, self._began, self._first = "", 0.0, 0.0
        self.pace = pace

    @property
    def seconds(self) -> float:
        """Seconds that the whole search takes."""
        return self._share * sum(self._seconds.values()) * self.pace

    def has_features(self, count: int) -> None:
        """So many were found in all photos."""
        self._expect(count)

    def left(self, phase: str, share: float) -> float:
        """Seconds left in all.

        Args:
            phase: What is done; NaN for one that is not in the forecast.
            share: How much of it is done, 0 to 1; the pace is learned where something is.
        """
        if phase not in self._seconds:
            return math.nan
        if phase != self._phase:
            # Of a search that goes on, much may be there already: that says nothing of the pace.
            self._phase, self._began, self._first = phase, self._clock(), share
        done = share - self._first
        forecast = self._share * self._seconds[phase]
        if done > 0.05 and phase in (FEATURES, MATCHING) and forecast > 0:
            self.pace = (self._clock() - self._began) / (done * forecast)
        names = list(self._seconds)
        later = sum(self._seconds[name] for name in names[names.index(phase) + 1 :])
        return self.pace * (forecast * (1 - share) + self._share * later)

    def _expect(self, features: float) -> None:
        each = features / max(self._photos, 1)
        self._seconds |= {
            MATCHING: self._pairs * (_VERIFY + _COMPARE * each),
            PLACING: _PLACE * features,
            ADJUSTING: _ADJUST * features,
        }
