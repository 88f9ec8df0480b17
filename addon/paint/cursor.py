"""Brush cursor: the circle drawn over the 3D view under the mouse."""

import bpy
import gpu
from gpu_extras.presets import draw_circle_2d

_LINE, _SHADOW = (1.0, 1.0, 1.0, 0.9), (0.0, 0.0, 0.0, 0.6)
_FAINT = (1.0, 1.0, 1.0, 0.4)
_SEGMENTS = 64


def draw_circle(place: tuple[float, float], radius: float, hardness: float) -> None:
    """Draw the brush, with a second circle where its falloff begins; all in pixels of a region."""
    gpu.state.blend_set("ALPHA")
    # Dark next to bright, so that it is visible over everything.
    draw_circle_2d(place, _SHADOW, radius + 1, segments=_SEGMENTS)
    draw_circle_2d(place, _LINE, radius, segments=_SEGMENTS)
    if 0 < hardness < 1:
        draw_circle_2d(place, _FAINT, hardness * radius, segments=_SEGMENTS)
    gpu.state.blend_set("NONE")


class Cursor:
    """Brush circle, drawn from its creation to `close`."""

    def __init__(self) -> None:
        self.region = 0
        """Pointer of the region of the cursor; 0: none."""
        self.place = (0.0, 0.0)
        """Pixels from that region's lower left."""
        self.radius = 0.0
        """Pixels."""
        self.hardness = 0.0
        """Share of the radius of the second circle, where the falloff begins."""
        self.to_source: tuple[float, float] | None = None
        """From the cursor to a further circle, pixels; None: there is none."""
        space = bpy.types.SpaceView3D
        self._handle = space.draw_handler_add(self._draw, (), "WINDOW", "POST_PIXEL")

    @property
    def state(self) -> tuple[object, ...]:
        """Values that determine the drawing."""
        return self.region, self.place, self.radius, self.hardness, self.to_source

    def close(self) -> None:
        """Stop drawing; may be called twice."""
        if self._handle is not None:
            bpy.types.SpaceView3D.draw_handler_remove(self._handle, "WINDOW")
            self._handle = None

    def _draw(self) -> None:
        if bpy.context.region.as_pointer() == self.region:
            draw_circle(self.place, self.radius, self.hardness)
            if self.to_source is not None:
                (x, y), (right, up) = self.place, self.to_source
                draw_circle((x + right, y + up), self.radius, 1.0)
