"""Where histograms lie in a view; pixels from its lower left. No bpy."""

from collections.abc import Iterable
from dataclasses import dataclass

_WIDTH, _HEIGHT = 260.0, 70.0
_LEAST = 120.0
"""Width below which there is none."""
_GAP = 28.0
"""Between two, and to the view's lower end: room for what is written above each."""
_MARGIN = 16.0
"""To what lies over the view at its sides."""


@dataclass(frozen=True)
class Box:
    """A rectangle."""

    x: float
    y: float
    width: float
    height: float

    @property
    def right(self) -> float:
        """Its other side."""
        return self.x + self.width

    @property
    def top(self) -> float:
        """Its upper end."""
        return self.y + self.height


def placed(view: Box, over: Iterable[Box], count: int, scale: float) -> list[Box]:
    """Boxes of one size at the view's lower end, in its middle: side by side where there is room,
    else one above the other; none where there is none.

    Args:
        view: All of it.
        over: What lies over it: toolbars, sidebars, and at its lower end, shelves.
        count: How many.
        scale: Of Blender's interface.
    """
    left, right, bottom = view.x, view.right, view.y
    for one in over:
        if one.width > 0.8 * view.width:  # all along the view
            if one.top < view.y + view.height / 2:
                bottom = max(bottom, one.top)
        elif one.x + one.right < view.x + view.right:
            left = max(left, one.right)
        else:
            right = min(right, one.x)
    margin, gap = _MARGIN * scale, _GAP * scale
    room = right - left - 2 * margin
    width, height = min(_WIDTH * scale, room), _HEIGHT * scale
    if width < _LEAST * scale:
        return []
    beside = count if count * (width + gap) - gap <= room else 1
    start = (left + right - beside * (width + gap) + gap) / 2
    return [
        Box(start + column * (width + gap), bottom + gap + row * (height + gap), width, height)
        for row, column in (divmod(number, beside) for number in range(count))
    ]
