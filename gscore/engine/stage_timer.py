"""Stage timer: seconds of the parts of a training step."""

import time
from collections.abc import Mapping


class StageTimer:
    """Seconds and rasterizer statistics of one step, by stage."""

    def __init__(self) -> None:
        self.pixels = 0
        """Number of rendered pixels of the view."""
        self.raster: dict[str, float] = {}
        """Counts and milliseconds of the rasterizer (gs_stats)."""
        self.seconds: dict[str, float] = {}
        """Seconds by stage, in execution order."""
        self._last = time.perf_counter()

    def add_raster(self, stats: Mapping[str, float]) -> None:
        """Add the statistics of another rendered image."""
        for name, value in stats.items():
            self.raster[name] = self.raster.get(name, 0.0) + value

    def add(self, seconds: Mapping[str, float], raster: Mapping[str, float]) -> None:
        """Add the stages and statistics of a step; the time since the last call is theirs."""
        for name, value in seconds.items():
            self.seconds[name] = self.seconds.get(name, 0.0) + value
        self.add_raster(raster)
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        """Add the time since the last call to stage `name`."""
        now = time.perf_counter()
        self.seconds[name] = self.seconds.get(name, 0.0) + now - self._last
        self._last = now
