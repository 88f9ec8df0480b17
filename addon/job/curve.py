"""The loss of a run as few numbers, and as a small picture; no bpy."""

import math
from collections.abc import Iterable

import numpy as np

_MOST = 256


class LossCurve:
    """Loss by step, thinned out to at most 256 points evenly spread over the run.

    When there are too many points, neighbours are averaged and from then on twice as many losses
    go into a point.
    """

    def __init__(self) -> None:
        self.steps: list[int] = []
        """Last step of each point."""
        self.losses: list[float] = []
        """Mean loss of each point."""
        self._per_point = 1
        self._waiting: list[float] = []

    @classmethod
    def of(cls, losses: Iterable[tuple[int, float]]) -> "LossCurve":
        """The curve of a run so far, by steps and losses in order."""
        curve = cls()
        for step, loss in losses:
            curve.add(step, loss)
        return curve

    def add(self, step: int, loss: float) -> None:
        """Take a loss; one that is no finite number is left out.

        A step that is not later than the last one means that the run went back: what came after
        it is forgotten.
        """
        if not math.isfinite(loss):
            return
        if self.steps and step <= self.steps[-1]:
            kept = sum(known < step for known in self.steps)
            del self.steps[kept:], self.losses[kept:]
            self._waiting.clear()
        self._waiting.append(loss)
        if len(self._waiting) < self._per_point:
            return
        self.steps.append(step)
        self.losses.append(sum(self._waiting) / len(self._waiting))
        self._waiting.clear()
        if len(self.steps) >= _MOST:
            self.steps = self.steps[1::2]
            pairs = zip(self.losses[0::2], self.losses[1::2], strict=True)
            self.losses = [(a + b) / 2 for a, b in pairs]
            self._per_point *= 2

    def picture(
        self,
        width: int,
        height: int,
        *,
        last_step: int,
        color: tuple[float, float, float] = (0.35, 0.65, 1.0),
    ) -> np.ndarray:
        """The curve over the whole run, the loss on a logarithmic axis.

        Args:
            width: Pixels.
            height: Pixels.
            last_step: Step at the right edge.
            color: Of the line, RGB in [0, 1].

        Returns:
            [height, width, 4] float32 RGBA, premultiplied, bottom row first, as icons are.
        """
        pixels = np.zeros((height, width, 4), np.float32)
        if len(self.losses) < 2:
            return pixels
        columns = np.arange(width)
        steps = np.array(self.steps, np.float64)
        logs = np.log(np.maximum(self.losses, 1e-9))
        x = steps / max(last_step, self.steps[-1], 1) * (width - 1)
        low, high = logs.min(), max(logs.max(), logs.min() + 0.05)
        y = np.interp(columns, x, (logs - low) / (high - low)) * (height - 3) + 1
        inside = (columns >= math.floor(x[0])) & (columns <= math.ceil(x[-1]))
        rows = np.arange(height)[:, None]
        # A steep part must not tear: the line covers all rows that it crosses in its column.
        beside = np.stack(
            [y, np.r_[y[:1], (y[1:] + y[:-1]) / 2], np.r_[(y[1:] + y[:-1]) / 2, y[-1:]]]
        )
        distance = np.maximum(np.maximum(beside.min(axis=0) - rows, rows - beside.max(axis=0)), 0)
        line = np.clip(1.5 - distance, 0, 1)
        under = np.where(rows < y, 0.18, 0.0)
        pixels[..., 3] = np.maximum(line, under) * inside
        pixels[..., :3] = pixels[..., 3:] * np.float32(color)
        return pixels
