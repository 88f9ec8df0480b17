"""Limit handles of histograms: the filter limit that each one moves, and its position."""

from dataclasses import dataclass
from typing import Any

from .counting import OPACITY, SIZE, Histogram


@dataclass(frozen=True)
class Handle:
    """A limit of the visible splats, on one side of a histogram."""

    kind: str
    """Kind of the histogram."""
    setting: str
    """Property of the object for the limit."""
    is_upper: bool

    @property
    def rest(self) -> float:
        """Position without a limit."""
        return 1.0 if self.is_upper else 0.0

    def place(self, histogram: Histogram, ob: Any) -> float:
        """Position for an object's limit, in [0, 1] from left to right."""
        limit = getattr(ob.gscore, self.setting)
        return histogram.place(limit) if limit > 0 else self.rest

    def move(self, histogram: Histogram, ob: Any, place: float) -> None:
        """Set the object's limit to the value at a position; none at its end of the axis. It does
        not pass the other handle."""
        for other in handles(self.kind):
            if other != self:
                bound = other.place(histogram, ob)
                place = max(place, bound) if self.is_upper else min(place, bound)
        place = min(max(place, 0.0), 1.0)
        setattr(ob.gscore, self.setting, 0.0 if place == self.rest else histogram.value(place))


_ALL = (
    Handle(OPACITY, "opacity_min", is_upper=False),
    Handle(SIZE, "size_min", is_upper=False),
    Handle(SIZE, "size_max", is_upper=True),
)


def handles(kind: str) -> list[Handle]:
    """Handles of a histogram, from left to right."""
    return [handle for handle in _ALL if handle.kind == kind]


def limits_of(ob: Any, kind: str) -> tuple[float, float]:
    """Smallest and largest value of a kind that pass an object's filters; 0: no limit."""
    ends = {handle.is_upper: getattr(ob.gscore, handle.setting) for handle in handles(kind)}
    return ends.get(False, 0.0), ends.get(True, 0.0)
