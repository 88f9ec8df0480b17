"""Samples of depth of field and motion blur: lens points and shutter times; no bpy."""

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

_GOLDEN = (5**0.5 - 1) / 2
"""Turns between consecutive points of a sunflower pattern (Vogel 1979)."""
_PLASTIC = 0.7548776662466927
"""Inverse of the plastic number: its multiples are spread as evenly, but in another order."""
_STEPS = 256
"""Steps of the integral of a shutter's curve."""


@dataclass(frozen=True, kw_only=True)
class Sample:
    """Lens point and time of one of the averaged pictures."""

    reach: float
    """Distance from the lens's middle, 0 to 1 at its edge, uniform over the area."""
    turn: float
    """Direction from the middle, 0 to 1 around it."""
    moment: float
    """Share of the exposure's light before this sample, 0 to 1."""


def samples(count: int) -> list[Sample]:
    """Deterministic samples in order of their moments.

    Moments are evenly spaced. Lens points form a sunflower pattern, in an order independent of
    their position, so that any few consecutive samples cover the whole lens.
    """
    if count == 1:
        return [Sample(reach=0.0, turn=0.0, moment=0.5)]
    index = np.arange(count)
    place = np.argsort(np.argsort(index * _PLASTIC % 1))
    reach, turn = np.sqrt((place + 0.5) / count), place * _GOLDEN % 1
    moment = (index + 0.5) / count
    return [
        Sample(reach=float(r), turn=float(t), moment=float(m))
        for r, t, m in zip(reach, turn, moment, strict=True)
    ]


@dataclass(frozen=True, kw_only=True)
class Aperture:
    """Aperture of a camera and its focus distance."""

    radius: float
    """World units."""
    distance: float
    """Focus distance along the camera's axis, world units."""
    blades: int = 0
    """Number of blades; fewer than three make a disk."""
    rotation: float = 0.0
    """Rotation of the blades, radians."""
    ratio: float = 1.0
    """Height divided by width."""

    def point(self, sample: Sample) -> tuple[float, float]:
        """The lens point of a sample, x to the right and y up, world units from the axis."""
        if self.blades < 3:
            angle = 2 * np.pi * sample.turn
            x, y = np.cos(angle), np.sin(angle)
        else:
            # Evenly along the sides, so that samples are uniform over the area too.
            side, along = divmod(sample.turn * self.blades, 1)
            half = np.pi / self.blades
            ends = self.rotation + half * (2 * side + np.array([-1, 1]))
            x, y = ((1 - along) * f(ends[0]) + along * f(ends[1]) for f in (np.cos, np.sin))
        reach = self.radius * sample.reach
        return float(reach * x / self.ratio), float(reach * y)


@dataclass(frozen=True, kw_only=True)
class Shutter:
    """Shutter times and curve of an exposure."""

    opens: float
    """Opening time, frames relative to the rendered one."""
    length: float
    """Exposure time, frames."""
    curve: tuple[float, ...] = ()
    """Openness at evenly spaced times; empty: fully open all the time."""
    row: float | None = None
    """Rolling shutter: share of the exposure during which one row of the picture is exposed, rows
    from top to bottom; None: all rows are exposed all the time."""

    def time(self, sample: Sample) -> float:
        """Time of a sample, in frames after the rendered one."""
        share = sample.moment
        if self.row is None:
            ends, light = self._light()
            share = float(np.interp(share, light, ends))
        return self.opens + self.length * share

    def shares(self, count: int, rows: np.ndarray) -> np.ndarray | None:
        """Weights of the samples in each row, [count, R] float32; None: equal weights.

        Args:
            count: Number of samples.
            rows: [R], positions of the rows, 0 at the picture's top and 1 at its bottom.
        """
        if self.row is None:
            return None
        # As in Cycles, the curve applies to each row.
        opens = (1 - self.row) * np.asarray(rows, np.float64)
        after = (np.linspace(0, 1, count + 1)[:, None] - opens) / max(self.row, 1e-6)
        return np.diff(np.interp(after, *self._light()), axis=0).astype(np.float32)

    def _light(self) -> tuple[np.ndarray, np.ndarray]:
        """Times as shares of the exposure, and the cumulative share of light at them."""
        ends = np.linspace(0, 1, _STEPS + 1)
        light = np.maximum(np.array(self.curve, np.float64), 0)
        if light.size < 2 or not light.any():
            return ends, ends
        middles = (ends[1:] + ends[:-1]) / 2
        amounts = np.interp(middles, np.linspace(0, 1, light.size), light)
        total = np.concatenate([[0], np.cumsum(amounts)])
        return ends, total / total[-1]


_Key = TypeVar("_Key", bound=Hashable)


class Mean(Generic[_Key]):
    """Mean of sets of pictures; a picture missing in a set counts as black."""

    def __init__(self) -> None:
        self._totals: dict[_Key, np.ndarray] = {}
        self._count = 0

    def add(self, pictures: Mapping[_Key, np.ndarray], shares: np.ndarray | None = None) -> None:
        """Add a set.

        Args:
            pictures: [H, W, ...] by key.
            shares: [H], weight of the set in each row; None: equal weights.
        """
        self._count += 1
        for key, values in pictures.items():
            if shares is not None:
                values = values * shares.reshape(-1, *[1] * (values.ndim - 1))
            if key in self._totals:
                self._totals[key] += values
            else:
                self._totals[key] = values.copy()
        self._whole = shares is not None

    _whole = False
    """Whether the weights of the sets add up to 1."""

    def result(self) -> dict[_Key, np.ndarray]:
        """The means; no set may be added afterwards."""
        for total in self._totals.values():
            if not self._whole:
                total /= np.float32(self._count)
        return self._totals
