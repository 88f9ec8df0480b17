"""Clipping of a view: near and far ends, and depth buffer values as camera depths; no gpu."""

from dataclasses import dataclass, field

import numpy as np

from ..cameras.render_camera import RenderCamera

PLANES = 6
"""That may cut a view."""


@dataclass(frozen=True, kw_only=True)
class Cuts:
    """Where a view ends: splats whose centers lie beyond are left out."""

    far: bool = False
    """Whether at the far end of the projection."""
    planes: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))
    """[P, 4] float64, P at most `PLANES`: normals, which point to what stays, and offsets, in
    Blender's world."""

    def same(self, other: "Cuts") -> bool:
        """Whether the other cuts the same."""
        return self.far == other.far and np.array_equal(self.planes, other.planes)

    def in_front_of(self, camera: RenderCamera) -> np.ndarray:
        """[P, 4] float64: the planes in a camera's space."""
        return self.planes @ np.linalg.inv(camera.viewmat)

    def kept(self, places: np.ndarray, camera: RenderCamera, window: np.ndarray) -> np.ndarray:
        """[N] bool: which splats stay.

        Args:
            places: [N, 3] of their centers, in the camera's space.
            camera: Of the view.
            window: As `depth_of_z`.
        """
        there = np.ones(len(places), bool)
        if self.far:
            there &= places[:, 2] <= z_of(np.ones((), np.float32), camera, window)
        for plane in self.in_front_of(camera):
            there &= places @ plane[:3].astype(places.dtype) + plane[3] >= 0
        return there


def depth_of_z(camera: RenderCamera, window: np.ndarray) -> tuple[float, float]:
    """Factor and offset: 2 x depth - 1 = (offset - factor z) / z, without the division where rays
    are parallel.

    Args:
        camera: Of the view. Orthographic ones were moved along their axis (`view_camera`); their
            own z is moved back.
        window: [4, 4] float64, Blender's projection.
    """
    factor, offset = window[2, 2], window[2, 3]
    if camera.orthographic:
        own_near = (offset + 1) / factor
        offset += factor * (camera.near - own_near)
    return factor, offset


def z_of(depths: np.ndarray, camera: RenderCamera, window: np.ndarray) -> np.ndarray:
    """The z in a camera's space of depths in [0, 1], of any shape; as `depth_of_z`."""
    factor, offset = depth_of_z(camera, window)
    place = 2 * depths.astype(np.float64) - 1
    if camera.orthographic:
        return (offset - place) / factor
    return offset / np.where(place + factor == 0, np.nan, place + factor)
