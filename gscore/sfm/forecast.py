"""Forecast of a camera search: total time before it, remaining time during it."""

import math
import os
import time
from collections.abc import Callable

FEATURES, MATCHING = "finding features", "comparing photos"
RECONSTRUCTION, ADJUSTING = "placing cameras", "adjusting cameras"
"""Phases of the forecast, in order."""

_LOOK, _DESCRIBE = 0.5, 9e-5
"""CPU seconds of feature extraction per megapixel, and per feature found. All of these constants
are from cores of a 2024 EPYC, with five captures of 29 to 60 photos; docs/sfm.md has the
measurements."""
_PER_MEGAPIXEL = 8000
"""Features per megapixel before extraction; measured 3,400 (walls) to 20,000 (grass)."""
_DOUBLED = 1.5
"""Features per kept one: some have two orientations."""
_COMPARE, _FIT, _FIT_EACH = 1.75e-9, 4e-3, 1e-6
"""CPU seconds per pair of features of two photos, and to fit a geometry to a pair of photos: per
pair, and per feature of a photo."""
_MATCHED = 0.5
"""Matches per feature before matching; measured 0.1 (lund) to 1.0 (studio, masked)."""
_PLACE, _ADJUST = 8.5e-5, 5.5e-5
"""CPU seconds per match, over all pairs."""
_BUSY_CORES = {RECONSTRUCTION: 1.3, ADJUSTING: 1.6}
"""Maximum number of cores that a phase uses; all for the others."""
_SURE = 0.25
"""Share of a phase after which its own pace counts alone; before, it is mixed with the last one."""
_THERE = 0.05
"""Ratio of elapsed to forecast seconds below which the work was already done by an earlier run."""
_MOST_GUESSED = 0.95
"""Maximum estimated share of a piece that is only timed: it may take longer than forecast."""


def working_cores(threads: int) -> int:
    """Number of working threads; 0: one per core."""
    return threads or os.cpu_count() or 1


def features_of(megapixels: float, most: int) -> float:
    """Expected number of features of a photo."""
    return min(_PER_MEGAPIXEL * megapixels, _DOUBLED * most)


class Forecast:
    """Forecast seconds of the phases, scaled by the pace measured in finished phases."""

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
        """Forecast from the sizes of the photos.

        Args:
            megapixels: Size of each photo at the resolution of feature extraction.
            most: Maximum number of features per photo.
            pairs: Number of pairs to match.
            threads: 0: one per core.
            pace: Measured seconds per forecast second, from an earlier forecast.
            clock: Seconds.
        """
        self._cores = working_cores(threads)
        self._megapixels, self._photos, self._pairs = sum(megapixels), len(megapixels), pairs
        self._clock = clock
        self._seconds: dict[str, float] = {}
        self._there: set[str] = set()
        self._expect(sum(features_of(size, most) for size in megapixels))
        self._phase = ""
        self._began = self._since = 0.0  # when the phase began, and when its share last grew
        self._first = self._reported = 0.0  # its share then
        self.pace = self._pace_before = pace
        self.share = 0.0
        """Share of the work done at the last call of `left`, 0 to 1; never decreases."""

    @property
    def seconds(self) -> float:
        """Seconds of the whole search."""
        return sum(self._seconds.values()) * self.pace

    def has(self, phase: str) -> None:
        """Mark a phase as done by an earlier attempt or search."""
        self._there.add(phase)
        self._seconds[phase] = 0.0

    def has_features(self, count: int, photos: int | None = None) -> None:
        """Set the number of features found in all photos, or in a sample of `photos`."""
        self._expect(count * self._photos / (self._photos if photos is None else photos))

    def has_pairs(self, count: int) -> None:
        """Set the number of pairs to match."""
        self._pairs = count
        self._expect(self._features)

    def has_matches(self, count: int) -> None:
        """Set the number of verified matches over all pairs."""
        self._expect_places(count)

    def left(self, phase: str, share: float, under_way: float = 0.0) -> float:
        """Remaining seconds of the search; NaN for an unknown phase.

        Args:
            phase: Name of the phase.
            share: Share of it that is done, 0 to 1; the pace is updated when it grows.
            under_way: Share in progress as one piece of unknown progress, 0 to 1; estimated from
                the elapsed time.
        """
        if phase not in self._seconds:
            return math.nan
        now, forecast = self._clock(), self._seconds[phase]
        if phase != self._phase:
            self._phase, self._began, self._first = phase, now, share
            self._pace_before, self._reported, self._since = self.pace, share, now
        if share > self._reported:
            if now - self._since < _THERE * self.pace * forecast * (share - self._reported):
                # A resumed search finds finished work, which must not count for the pace.
                self._first, self._began = self._first + share - self._reported, now
            self._reported, self._since = share, now
            if phase in (FEATURES, MATCHING) and forecast > 0:
                self._learn(share - self._first, forecast)
        if forecast > 0:
            guessed = (now - self._since) / (self.pace * forecast)
            share = min(share + min(guessed, _MOST_GUESSED * under_way), 1.0)
        return self._left(phase, share)

    def _learn(self, done: float, forecast: float) -> None:
        """Update the pace from a share of a phase and the forecast seconds of the whole phase."""
        if done <= 0:
            return
        own = (self._since - self._began) / (done * forecast)
        sure = min(done / _SURE, 1.0)
        self.pace = self._pace_before + sure * (own - self._pace_before)

    def _left(self, phase: str, share: float) -> float:
        """Remaining seconds after a share of a phase; updates `share`."""
        names = list(self._seconds)
        place, whole = names.index(phase), sum(self._seconds.values())
        rest = self._seconds[phase] * (1 - share)
        rest += sum(self._seconds[name] for name in names[place + 1 :])
        if whole > 0:
            self.share = max(self.share, 1 - rest / whole)
        return self.pace * rest

    def _expect(self, features: float) -> None:
        """Update the forecast to `features` in all photos."""
        self._features = features
        each = features / max(self._photos, 1)
        self._take(FEATURES, _LOOK * self._megapixels + _DESCRIBE * features)
        self._take(MATCHING, self._pairs * (_FIT + (_FIT_EACH + _COMPARE * each) * each))
        self._expect_places(_MATCHED * features)

    def _expect_places(self, matches: float) -> None:
        self._take(RECONSTRUCTION, _PLACE * matches)
        self._take(ADJUSTING, _ADJUST * matches)

    def _take(self, phase: str, cpu_seconds: float) -> None:
        """Set the seconds of a phase on an idle machine."""
        if phase not in self._there:
            self._seconds[phase] = cpu_seconds / min(
                self._cores, _BUSY_CORES.get(phase, self._cores)
            )
