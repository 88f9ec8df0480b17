"""Counting of splats by opacity and size, and pictures of the counts; no bpy."""

from dataclasses import dataclass

import numpy as np

OPACITY, SIZE = "opacity", "size"
"""Kinds of histograms."""
SHOWN = (0.3, 0.6, 0.95)
HIDDEN = (0.45, 0.45, 0.45)
"""Colours of bars, RGB in [0, 1]."""
_BINS = 96
_TAILS = (0.001, 0.999)
"""Quantiles of the drawn range of sizes; the rest is at its ends."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Histogram:
    """Counts along an axis."""

    counts: np.ndarray
    """[bins] int64."""
    low: float
    """Value at the left end, or its logarithm."""
    high: float
    """Value at the right end, or its logarithm."""
    logarithmic: bool
    """True if the axis is in natural logarithms."""

    def place(self, value: float) -> float:
        """Position of a value on the axis, from 0 at its left to 1 at its right end."""
        if self.logarithmic:
            value = np.log(max(value, 1e-30))
        return float(np.clip((value - self.low) / (self.high - self.low), 0, 1))

    def value(self, place: float) -> float:
        """Value at a position on the axis, the inverse of `place`."""
        value = self.low + place * (self.high - self.low)
        return float(np.exp(value)) if self.logarithmic else float(value)

    def heights(self) -> np.ndarray:
        """Heights of the bars, [bins] in [0, 1], proportional to the square roots of the counts."""
        return np.sqrt(self.counts / max(int(self.counts.max(initial=0)), 1))

    def ends(self, smallest: float, largest: float) -> tuple[float, float]:
        """Positions of the two limits on the axis; a limit of 0 is none."""
        return (
            self.place(smallest) if smallest > 0 else 0.0,
            self.place(largest) if largest > 0 else 1.0,
        )

    def picture(self, width: int, height: int, smallest: float, largest: float) -> np.ndarray:
        """The counts as bars.

        Args:
            width: Pixels.
            height: Pixels.
            smallest: Bars below are drawn as hidden.
            largest: Bars above too; 0: none.

        Returns:
            [height, width, 4] float32 RGBA, premultiplied, bottom row first, as for icons.
        """
        column = (np.arange(width) + 0.5) / width
        tall = self.heights()
        bars = tall[np.minimum((column * len(tall)).astype(int), len(tall) - 1)] * height
        low, high = self.ends(smallest, largest)
        shown = (column >= low) & (column <= high)
        pixels = np.zeros((height, width, 4), np.float32)
        alpha = np.clip(bars - np.arange(height)[:, None], 0, 1) * np.where(shown, 1.0, 0.6)
        pixels[..., 3] = alpha
        pixels[..., :3] = alpha[..., None] * np.where(shown[:, None], SHOWN, HIDDEN)
        return pixels


def of_opacities(opacities: np.ndarray) -> Histogram:
    """Histogram of opacities [N] in [0, 1]."""
    counts, _ = np.histogram(opacities, _BINS, (0, 1))
    return Histogram(counts=counts, low=0.0, high=1.0, logarithmic=False)


def of_sizes(sizes: np.ndarray) -> Histogram:
    """Histogram of positive sizes [N], on a logarithmic axis."""
    logs = np.log(np.maximum(sizes, 1e-30))
    low, high = np.quantile(logs, _TAILS) if len(logs) else (0.0, 1.0)
    low, high = (low, high) if high - low > 1e-3 else (low - 0.5, low + 0.5)
    counts, _ = np.histogram(np.clip(logs, low, high), _BINS, (low, high))
    return Histogram(counts=counts, low=float(low), high=float(high), logarithmic=True)
