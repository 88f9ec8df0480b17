"""Clipping of a view: far end and planes, and depth buffer values; no gpu."""

from dataclasses import dataclass, field

import numpy as np

from ..cameras.render_camera import RenderCamera

PLANES = 6
"""Most clipping planes of a view."""


@dataclass(frozen=True, kw_only=True)
class Cuts:
    """Clipping of a view: splats with centers outside are not drawn."""

    far: bool = False
    """Whether the far end of the projection clips."""
    planes: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))
    """[P, 4] float64, P at most `PLANES`: inward normals and offsets, in Blender's world."""


def depth_of_z(camera: RenderCamera, window: np.ndarray) -> tuple[float, float]:
    """Factor and offset of 2 x depth - 1 = (offset - factor z) / z, without the division for
    orthographic cameras.

    Args:
        camera: The view's camera. Orthographic ones were moved along their axis (`view_camera`),
            which is undone here.
        window: [4, 4] float64, Blender's projection.
    """
    factor, offset = window[2, 2], window[2, 3]
    if camera.orthographic:
        own_near = (offset + 1) / factor
        offset += factor * (camera.near - own_near)
    return factor, offset
