"""Drawing of a histogram with handles over a 3D view."""

import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader

from ..interface import viewport_text
from .boxes import Box
from .counting import HIDDEN, SHOWN, Histogram

_BACK = (0.1, 0.1, 0.1, 0.75)
_HANDLE, _BRIGHT = (0.75, 0.75, 0.75, 1.0), (1.0, 1.0, 1.0, 1.0)
_PADDING = 6.0
_GRIP = 6.0
"""Half the width of a handle's foot; pixels at interface scale 1, as all sizes here."""


def draw(
    box: Box,
    histogram: Histogram,
    title: str,
    limits: tuple[float, float],
    places: list[float],
    bright: int | None,
    scale: float,
) -> None:
    """Draw bars, handles and text, in pixels of the drawn region.

    Args:
        box: Box of the bars.
        histogram: Counts.
        title: Text above the bars.
        limits: Smallest and largest visible value; 0: no limit.
        places: Positions of the handles, in [0, 1].
        bright: Index of the handle under the mouse.
        scale: Interface scale of Blender.
    """
    pad = _PADDING * scale
    shapes = [(_rectangle(box.x - pad, box.y - pad, box.right + pad, box.top + pad), _BACK)]
    low, high = histogram.ends(*limits)
    tall = box.height * histogram.heights()
    edges = np.linspace(0, 1, len(tall) + 1)
    for i, height in enumerate(tall):
        middle = (edges[i] + edges[i + 1]) / 2
        color = (*SHOWN, 1.0) if low <= middle <= high else (*HIDDEN, 1.0)
        sides = box.x + box.width * edges[i : i + 2]
        shapes.append((_rectangle(sides[0], box.y, sides[1], box.y + height), color))
    for i, place in enumerate(places):
        color, x = (_BRIGHT if i == bright else _HANDLE), box.x + box.width * place
        shapes.append((_rectangle(x - scale, box.y, x + scale, box.top), color))
        shapes.append((_foot(x, box.y, _GRIP * scale), color))
    _fill(shapes)
    text, above = limit_text(*limits), box.top + 1.5 * pad
    viewport_text.write(title, box.x, above, scale, _BRIGHT)
    viewport_text.write(
        text, box.right - viewport_text.width_of(text, scale), above, scale, _BRIGHT
    )


def limit_text(smallest: float, largest: float) -> str:
    """Limits in words."""
    low, high = map(_number, (smallest, largest))
    if smallest > 0 and largest > 0:
        return f"{low} to {high}"
    if smallest > 0:
        return f"{low} and more"
    return f"up to {high}" if largest > 0 else "all"


def _number(value: float) -> str:
    return np.format_float_positional(value, precision=2, fractional=False, trim="-")


def _rectangle(left: float, low: float, right: float, high: float) -> list[tuple[float, float]]:
    """Two triangles."""
    corners = (left, low), (right, low), (right, high), (left, high)
    return [corners[i] for i in (0, 1, 2, 0, 2, 3)]


def _foot(x: float, y: float, size: float) -> list[tuple[float, float]]:
    """A triangle that points up to a position on the axis."""
    return [(x - size, y - size), (x + size, y - size), (x, y + size)]


def _fill(shapes: list[tuple[list[tuple[float, float]], tuple[float, ...]]]) -> None:
    """Draw triangles, each in the color of its shape."""
    shader = gpu.shader.from_builtin("FLAT_COLOR")
    places = [(x, y, 0.0) for corners, _ in shapes for x, y in corners]
    colors = [color for corners, color in shapes for _ in corners]
    gpu.state.blend_set("ALPHA")
    batch_for_shader(shader, "TRIS", {"pos": places, "color": colors}).draw(shader)
    gpu.state.blend_set("NONE")
