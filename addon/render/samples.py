"""Samples of depth of field and motion blur: lens points and shutter times; no bpy."""

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

_GOLDEN = (5**0.5 - 1) / 2
"""Turns from one point to the next of a sunflower's (Vogel 1979), which no two points share."""
_PLASTIC = 0.7548776662466927
"""Inverse of the plastic number: shares of it are spread as evenly, and otherwise."""
_STEPS = 256
"""In which a shutter's curve is added up."""


@dataclass(frozen=True, kw_only=True)
class Sample:
    """One of the pictures."""

    reach: float
    """Distance from the lens's middle, 0 to 1 at its edge; equal areas are met equally often."""
    turn: float
    """Direction from the middle, 0 to 1 around it."""
    moment: float
    """How much of the light of the exposure came before, 0 to 1."""


def samples(count: int) -> list[Sample]:
    """As many as wanted, in the order of their moments, the same each time.

    Moments follow each other evenly. On the lens points lie as in a sunflower, and are taken in an
    order that has nothing to do with their place, so that early ones lie everywhere.
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
    """The hole through which a camera's light falls, and what is in focus."""

    radius: float
    """World units."""
    distance: float
    """Of what is in focus, along the camera's axis, world units."""
    blades: int = 0
    """Sides of the hole; fewer than three make a disk."""
    rotation: float = 0.0
    """Of the blades, radians."""
    ratio: float = 1.0
    """Height of the hole in relation to its width."""

    def point(self, sample: Sample) -> tuple[float, float]:
        """Where a sample's light passes, x to the right and y up, world units from the axis."""
        if self.blades < 3:
            angle = 2 * np.pi * sample.turn
            x, y = np.cos(angle), np.sin(angle)
        else:
            # Evenly along the sides, so that areas are met evenly too.
            side, along = divmod(sample.turn * self.blades, 1)
            half = np.pi / self.blades
            ends = self.rotation + half * (2 * side + np.array([-1, 1]))
            x, y = ((1 - along) * f(ends[0]) + along * f(ends[1]) for f in (np.cos, np.sin))
        reach = self.radius * sample.reach
        return float(reach * x / self.ratio), float(reach * y)


@dataclass(frozen=True, kw_only=True)
class Shutter:
    """When light falls onto the film."""

    opens: float
    """Frames after the one that is rendered."""
    length: float
    """Frames that it stays open."""
    curve: tuple[float, ...] = ()
    """How open it is, at moments that follow each other evenly; empty: quite, all the time."""
    row: float | None = None
    """Share of the exposure in which a row of the picture gets its light, where rows get it one
    after the other, from the top down; None: all of them all the time."""

    def time(self, sample: Sample) -> float:
        """When a sample is taken, in frames after the one that is rendered."""
        share = sample.moment
        if self.row is None:
            ends, light = self._light()
            share = float(np.interp(share, light, ends))
        return self.opens + self.length * share

    def shares(self, count: int, rows: np.ndarray) -> np.ndarray | None:
        """How much of the light of a row each sample is of, [count, R] float32; None: an even part.

        Args:
            count: Of samples.
            rows: [R], places of the rows, 0 at the picture's top and 1 at its bottom.
        """
        if self.row is None:
            return None
        # As Cycles does it: the curve is that of a row.
        opens = (1 - self.row) * np.asarray(rows, np.float64)
        after = (np.linspace(0, 1, count + 1)[:, None] - opens) / max(self.row, 1e-6)
        return np.diff(np.interp(after, *self._light()), axis=0).astype(np.float32)

    def _light(self) -> tuple[np.ndarray, np.ndarray]:
        """Shares of the exposure, and how much of its light has come until then."""
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
    """Of sets of pictures; one that a set lacks is black in it."""

    def __init__(self) -> None:
        self._totals: dict[_Key, np.ndarray] = {}
        self._count = 0

    def add(self, pictures: Mapping[_Key, np.ndarray], shares: np.ndarray | None = None) -> None:
        """Take one more set.

        Args:
            pictures: [H, W, ...] by key.
            shares: [H], how much of each row it is; None: as much as every other set.
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
    """Whether the shares make a whole."""

    def result(self) -> dict[_Key, np.ndarray]:
        """The means; nothing may be added any more."""
        for total in self._totals.values():
            if not self._whole:
                total /= np.float32(self._count)
        return self._totals
