"""The brush's circle, drawn over the 3D view that the mouse is in."""

import bpy
import gpu
from gpu_extras.presets import draw_circle_2d

_LINE, _SHADOW = (1.0, 1.0, 1.0, 0.9), (0.0, 0.0, 0.0, 0.6)
_FAINT = (1.0, 1.0, 1.0, 0.4)
_SEGMENTS = 64


class Cursor:
    """Is drawn from its making to `close`."""

    def __init__(self) -> None:
        self.region = 0
        """Pointer of the region that it is drawn in; 0: none."""
        self.place = (0.0, 0.0)
        """Pixels from that region's lower left."""
        self.radius = 0.0
        """Pixels."""
        self.hardness = 0.0
        """Share of the radius at which a second circle shows where the brush begins to fade."""
        space = bpy.types.SpaceView3D
        self._handle = space.draw_handler_add(self._draw, (), "WINDOW", "POST_PIXEL")

    @property
    def state(self) -> tuple[object, ...]:
        """All of what is drawn depends on."""
        return self.region, self.place, self.radius, self.hardness

    def close(self) -> None:
        """Draw it no more; may be called twice."""
        if self._handle is not None:
            bpy.types.SpaceView3D.draw_handler_remove(self._handle, "WINDOW")
            self._handle = None

    def _draw(self) -> None:
        if bpy.context.region.as_pointer() != self.region:
            return
        gpu.state.blend_set("ALPHA")
        # Dark beside bright, so that it is seen over everything.
        draw_circle_2d(self.place, _SHADOW, self.radius + 1, segments=_SEGMENTS)
        draw_circle_2d(self.place, _LINE, self.radius, segments=_SEGMENTS)
        if 0 < self.hardness < 1:
            inner = self.hardness * self.radius
            draw_circle_2d(self.place, _FAINT, inner, segments=_SEGMENTS)
        gpu.state.blend_set("NONE")
