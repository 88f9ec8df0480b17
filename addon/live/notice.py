"""Says in a 3D view why its splats are not drawn by the graphics card."""

from dataclasses import dataclass

import blf
import bpy

from ..splats.live import SESSION
from ..splats.objects import is_splats
from . import handler

_FONT, _SIZE = 0, 11.0
_MARGIN = 12.0
"""Pixels, for a screen of usual resolution, like the size."""
_COLOR = 1.0, 0.75, 0.2, 1.0


@dataclass
class _State:
    handle: object = None


_state = _State()


def lines(text: str, width: float) -> list[str]:
    """A text in lines of at most so many pixels, in the size that was set last."""
    found: list[str] = []
    for word in text.split():
        longer = f"{found[-1]} {word}" if found else word
        if found and blf.dimensions(_FONT, longer)[0] <= width:
            found[-1] = longer
        else:
            found.append(word)
    return found


def _draw() -> None:
    context = bpy.context
    overlay = context.space_data.overlay
    text = handler.problem_of(context.region)
    if not text or not (overlay.show_overlays and overlay.show_text):
        return
    if not any(map(is_splats, context.scene.objects)):
        return
    scale = context.preferences.system.ui_scale
    blf.size(_FONT, _SIZE * scale)
    blf.color(_FONT, *_COLOR)
    blf.enable(_FONT, blf.SHADOW)
    blf.shadow(_FONT, 3, 0.0, 0.0, 0.0, 0.8)
    free = [r.width for r in context.area.regions if r.type == "UI"]  # which lies over the view
    shown = lines(text, context.region.width - sum(free) - 4 * _MARGIN * scale)
    for number, line in enumerate(reversed(shown)):
        height = (_MARGIN + 1.5 * _SIZE * number) * scale
        blf.position(_FONT, 2 * _MARGIN * scale, height, 0)
        blf.draw(_FONT, line)
    blf.disable(_FONT, blf.SHADOW)


def on_register() -> None:
    """Draw in all 3D views, where there is a window."""
    if SESSION.there:
        _state.handle = bpy.types.SpaceView3D.draw_handler_add(_draw, (), "WINDOW", "POST_PIXEL")


def on_unregister() -> None:
    """Draw no more."""
    if _state.handle is not None:
        bpy.types.SpaceView3D.draw_handler_remove(_state.handle, "WINDOW")
        _state.handle = None
