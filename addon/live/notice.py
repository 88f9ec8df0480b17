"""Notice in a 3D view: why the graphics card does not draw its splats."""

import bpy

from ..interface import viewport_text
from ..splats.objects import is_splats
from . import draw_handler

_MARGIN = 12.0
"""Pixels at a resolution scale of 1."""
_COLOR = 1.0, 0.75, 0.2, 1.0


def _lines(text: str, width: float, scale: float) -> list[str]:
    """A text wrapped to a width in pixels."""
    found: list[str] = []
    for word in text.split():
        longer = f"{found[-1]} {word}" if found else word
        if found and viewport_text.width_of(longer, scale) <= width:
            found[-1] = longer
        else:
            found.append(word)
    return found


def _draw() -> None:
    context = bpy.context
    overlay = context.space_data.overlay
    text = draw_handler.problem_of(context.region)
    if not text or not (overlay.show_overlays and overlay.show_text):
        return
    if not any(map(is_splats, context.scene.objects)):
        return
    scale = context.preferences.system.ui_scale
    sidebar = [r.width for r in context.area.regions if r.type == "UI"]  # overlaps the view
    shown = _lines(text, context.region.width - sum(sidebar) - 4 * _MARGIN * scale, scale)
    for number, line in enumerate(reversed(shown)):
        height = (_MARGIN + 1.5 * viewport_text.SIZE * number) * scale
        viewport_text.write(line, 2 * _MARGIN * scale, height, scale, _COLOR)


DRAWING = ((_draw, "POST_PIXEL"),)
