"""Training curve: loss and PSNR of a run, downsampled, and drawn as a small picture; no bpy."""

import math
from collections.abc import Iterable, Sequence

import numpy as np

LOSS_COLOR, PSNR_COLOR = (0.35, 0.65, 1.0), (1.0, 0.6, 0.2)
"""Line colors, RGB in [0, 1]; distinct also for red-green colour blindness."""
_MOST = 256


class Curve:
    """Loss and PSNR by step, as at most 256 points evenly spread over the run.

    When it is full, neighbours are averaged and each further point averages twice as many values.
    """

    def __init__(self) -> None:
        self.steps: list[int] = []
        """Last step of each point."""
        self.losses: list[float] = []
        """Mean loss of each point."""
        self.psnrs: list[float] = []
        """Mean PSNR of each point, dB."""
        self._per_point = 1
        self._waiting: list[tuple[float, float]] = []

    @classmethod
    def of(cls, course: Iterable[tuple[int, float, float]]) -> "Curve":
        """The curve of a run so far, by steps, losses and PSNRs in order."""
        curve = cls()
        for step, loss, psnr in course:
            curve.add(step, loss, psnr)
        return curve

    def add(self, step: int, loss: float, psnr: float) -> None:
        """Add the values of a step; non-finite ones are skipped.

        A step that is not after the last one means that the run went back to a checkpoint: later
        points are removed.
        """
        if not (math.isfinite(loss) and math.isfinite(psnr)):
            return
        if self.steps and step <= self.steps[-1]:
            kept = sum(known < step for known in self.steps)
            del self.steps[kept:], self.losses[kept:], self.psnrs[kept:]
            self._waiting.clear()
        self._waiting.append((loss, psnr))
        if len(self._waiting) < self._per_point:
            return
        losses, psnrs = zip(*self._waiting, strict=True)
        self.steps.append(step)
        self.losses.append(sum(losses) / len(losses))
        self.psnrs.append(sum(psnrs) / len(psnrs))
        self._waiting.clear()
        if len(self.steps) >= _MOST:
            self.steps = self.steps[1::2]
            self.losses, self.psnrs = _halved(self.losses), _halved(self.psnrs)
            self._per_point *= 2

    def picture(self, width: int, height: int, *, last_step: int) -> np.ndarray:
        """Picture of both curves, each scaled to its range: the loss on a logarithmic axis, with a
        tint below it, and the PSNR above.

        Args:
            width: Pixels.
            height: Pixels.
            last_step: Step at the right edge.

        Returns:
            [height, width, 4] float32 RGBA, premultiplied, bottom row first, for icons.
        """
        if len(self.steps) < 2:
            return np.zeros((height, width, 4), np.float32)
        x = np.array(self.steps, np.float64) / max(last_step, self.steps[-1], 1) * (width - 1)
        logs = np.log(np.maximum(self.losses, 1e-9))
        y, line, inside = _line(x, logs, 0.05, width, height)
        under = np.where(np.arange(height)[:, None] < y, 0.18, 0.0)
        below = np.maximum(line, under * inside)
        _, over, _ = _line(x, np.array(self.psnrs), 0.2, width, height)
        # A gap of two pixels around the upper line keeps both visible at crossings.
        padded = np.pad(over, ((2, 2), (0, 0)))
        widened = np.max([padded[k : k + height] for k in range(5)], axis=0)
        clear = np.clip(1 - widened, 0, 1)
        pixels = np.empty((height, width, 4), np.float32)
        pixels[..., 3] = over + (1 - over) * below * clear
        shares = over[..., None], ((1 - over) * below * clear)[..., None]
        pixels[..., :3] = shares[0] * np.float32(PSNR_COLOR) + shares[1] * np.float32(LOSS_COLOR)
        return pixels


def _halved(values: Sequence[float]) -> list[float]:
    return [(a + b) / 2 for a, b in zip(values[0::2], values[1::2], strict=True)]


def _line(
    x: np.ndarray, values: np.ndarray, least: float, width: int, height: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A line through points, rasterized.

    Args:
        x: Columns of the points, increasing.
        values: Values of the points; the lowest is at the bottom and the highest at the top.
        least: Smallest range between bottom and top, in units of `values`.
        width: Width of the picture, pixels.
        height: Height of the picture, pixels.

    Returns:
        Row of the line in each column [width], coverage of each pixel [height, width], and the
        mask of the columns that it crosses [width].
    """
    columns = np.arange(width)
    low, high = values.min(), max(values.max(), values.min() + least)
    y = np.interp(columns, x, (values - low) / (high - low)) * (height - 3) + 1
    inside = (columns >= math.floor(x[0])) & (columns <= math.ceil(x[-1]))
    rows = np.arange(height)[:, None]
    # The line covers all rows that it crosses in a column, so that steep parts have no gaps.
    spans = np.stack([y, np.r_[y[:1], (y[1:] + y[:-1]) / 2], np.r_[(y[1:] + y[:-1]) / 2, y[-1:]]])
    distance = np.maximum(np.maximum(spans.min(axis=0) - rows, rows - spans.max(axis=0)), 0)
    return y, np.clip(1.5 - distance, 0, 1) * inside, inside
