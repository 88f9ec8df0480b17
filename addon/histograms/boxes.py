"""Boxes of histograms in a view, in pixels from its lower left; no bpy."""

from collections.abc import Sequence
from dataclasses import dataclass

_WIDTH, _HEIGHT = 260.0, 70.0
_LEAST = 120.0
"""Smallest width of a box."""
_GAP = 28.0
"""Gaps between boxes and above and below them, with room for their titles."""
_MARGIN = 16.0
"""Distance from overlapping regions at the sides."""


@dataclass(frozen=True)
class Box:
    """A rectangle."""

    x: float
    y: float
    width: float
    height: float

    @property
    def right(self) -> float:
        """Right side."""
        return self.x + self.width

    @property
    def top(self) -> float:
        """Upper side."""
        return self.y + self.height

    def meets(self, other: "Box") -> bool:
        """True if the boxes overlap."""
        across = self.x < other.right and other.x < self.right
        return across and self.y < other.top and other.y < self.top


@dataclass(frozen=True, kw_only=True)
class OverlappingRegions:
    """Regions over a view."""

    left: Sequence[Box] = ()
    right: Sequence[Box] = ()
    above: Sequence[Box] = ()
    below: Sequence[Box] = ()
    floating: Sequence[Box] = ()


def placed(view: Box, over: OverlappingRegions, count: int, scale: float) -> list[Box]:
    """Boxes of one size at the view's lower right, away from the settings of the last operator:
    side by side if they fit, else stacked, as many as fit; above overlapping regions.

    Args:
        view: The whole view.
        over: Regions over it.
        count: Number of boxes.
        scale: Interface scale of Blender.
    """
    left = max([view.x, *(one.right for one in over.left)])
    right = min([view.right, *(one.x for one in over.right)])
    top = min([view.top, *(one.y for one in over.above)])
    bottom = max([view.y, *(one.top for one in over.below)])
    free = Box(left, bottom, right - left, top - bottom)
    boxes = _filled(free, count, scale)
    in_the_way = [one for one in over.floating if any(map(one.meets, boxes))]
    if in_the_way:
        bottom = max(one.top for one in in_the_way)
        boxes = _filled(Box(left, bottom, right - left, top - bottom), count, scale)
    return boxes


def _filled(free: Box, count: int, scale: float) -> list[Box]:
    margin, gap = _MARGIN * scale, _GAP * scale
    room = free.width - 2 * margin
    width, height = min(_WIDTH * scale, room), _HEIGHT * scale
    if width < _LEAST * scale:
        return []
    columns = count if count * (width + gap) - gap <= room else 1
    start = free.right - margin - columns * (width + gap) + gap
    boxes = [
        Box(start + column * (width + gap), free.y + gap + row * (height + gap), width, height)
        for row, column in (divmod(number, columns) for number in range(count))
    ]
    return [box for box in boxes if box.top + gap <= free.top]
