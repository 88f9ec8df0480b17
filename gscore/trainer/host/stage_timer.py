"""Stage timer: seconds of the parts of a training step."""

import time
from collections.abc import Mapping


class StageTimer:
    """A stopwatch that is read between the parts of a step, and what else tells its cost."""

    def __init__(self) -> None:
        self.pixels = 0
        """Of the view, at the size it was drawn."""
        self.raster: dict[str, float] = {}
        """Counts and milliseconds of the rasterizer (gs_stats)."""
        self.seconds: dict[str, float] = {}
        """By part, in the order in which they came."""
        self._last = time.perf_counter()

    def add_raster(self, stats: Mapping[str, float]) -> None:
        """Add what another picture took to that of those before."""
        for name, value in stats.items():
            self.raster[name] = self.raster.get(name, 0.0) + value

    def lap(self, name: str) -> None:
        """What has passed since the last call belongs to `name`."""
        now = time.perf_counter()
        self.seconds[name] = self.seconds.get(name, 0.0) + now - self._last
        self._last = now
