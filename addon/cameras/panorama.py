"""Panoramic cameras of Blender: the ray direction of each pixel, by Cycles' formulas."""

from dataclasses import dataclass

import bpy
import numpy as np

from ..compat import matrix_to_numpy, panorama_settings
from .camera_math import fitted_side
from .objects import frame_of, lens_of, rigid_viewmat

EQUIRECTANGULAR = "EQUIRECTANGULAR"
EQUIDISTANT = "FISHEYE_EQUIDISTANT"
EQUISOLID = "FISHEYE_EQUISOLID"
KINDS = {
    EQUIRECTANGULAR: ("latitude_min", "latitude_max", "longitude_min", "longitude_max"),
    EQUIDISTANT: ("fisheye_fov",),
    EQUISOLID: ("fisheye_lens", "fisheye_fov"),
}
"""Supported panorama types by Blender's names, with their settings."""


@dataclass(frozen=True, kw_only=True)
class Panorama:
    """A panoramic camera."""

    viewmat: np.ndarray
    """[4, 4] float64, Blender's world to camera, OpenCV axes."""
    width: int
    """Pixels."""
    height: int
    """Pixels."""
    near: float
    """Clip start, world units."""
    kind: str
    """One of `KINDS`."""
    settings: tuple[float, ...]
    """Values of the settings in `KINDS`, radians and millimetres."""
    shift: tuple[float, float] = (0.0, 0.0)
    """Shift of the picture, in widths to the left and in heights down."""
    pixel: tuple[float, float] = (0.0, 0.0)
    """Width and height of a pixel on the sensor, millimetres."""

    @property
    def density(self) -> float:
        """Largest number of pixels per radian."""
        if self.kind == EQUIRECTANGULAR:
            low, high, left, right = self.settings
            across = self.width / max(abs(right - left), 1e-6)
            return max(across, self.height / max(abs(high - low), 1e-6))
        if self.kind == EQUIDISTANT:
            return max(self.width, self.height) / max(self.settings[0], 1e-6)
        return self.settings[0] / min(self.pixel)

    def directions(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Ray directions of image points.

        Args:
            x: [...] pixels from the left side.
            y: [...] pixels from the upper side.

        Returns:
            [..., 3] unit vectors in camera axes (OpenCV), and [...] bool, True inside the picture
            of the lens.
        """
        right = x / self.width - 0.5 + self.shift[0]
        up = 0.5 - y / self.height + self.shift[1]
        if self.kind == EQUIRECTANGULAR:
            return self._on_a_map(right, up)
        if self.kind == EQUIDISTANT:
            reach = np.hypot(right, up) * 2
            angle, inside = reach * self.settings[0] / 2, reach <= 1
        else:
            lens, fov = self.settings
            right, up = right * self.width * self.pixel[0], up * self.height * self.pixel[1]
            reach = np.hypot(right, up)
            inside = reach <= 2 * lens * np.sin(fov / 4)
            angle = 2 * np.arcsin(np.minimum(reach / (2 * lens), 1))
        across = np.sin(angle) / np.maximum(np.hypot(right, up), 1e-30)
        return np.stack([right * across, -up * across, np.cos(angle)], -1), inside

    def _on_a_map(self, right: np.ndarray, up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        low, high, left, end = self.settings
        longitude = left + (right + 0.5) * (end - left)
        latitude = low + (up + 0.5) * (high - low)
        level = np.cos(latitude)
        axes = level * np.sin(longitude), -np.sin(latitude), level * np.cos(longitude)
        return np.stack(axes, -1), np.ones(right.shape, bool)


def kind_of(data: bpy.types.Camera) -> str:
    """Blender's name of the kind of a panoramic camera; empty if unknown."""
    return getattr(panorama_settings(data), "panorama_type", "")


def panorama_of(
    ob: bpy.types.Object, scene: bpy.types.Scene, *, width: int, height: int
) -> Panorama:
    """A panoramic camera as Cycles renders with it.

    Args:
        ob: The camera, evaluated.
        scene: Gives the pixel aspect.
        width: Pixels.
        height: Pixels.

    Raises:
        ValueError: the kind of panorama is unsupported, or the matrix is not a pose.
    """
    own, kind = panorama_settings(ob.data), kind_of(ob.data)
    if kind not in KINDS:
        named = kind.replace("_", " ").lower() or "of a kind that only Cycles knows"
        raise ValueError(
            f"Camera {ob.name} is {named}; panoramas of splats are equirectangular, or fisheye "
            "equidistant or equisolid. Set its Panorama Type to one of these."
        )
    frame, lens = frame_of(scene, width, height), lens_of(ob.data)
    sensor = lens.sensor_height if lens.sensor_fit == "VERTICAL" else lens.sensor_width
    pixel = sensor / fitted_side(lens, frame)
    return Panorama(
        viewmat=rigid_viewmat(matrix_to_numpy(ob.matrix_world), ob.name),
        width=width,
        height=height,
        near=ob.data.clip_start,
        kind=kind,
        settings=tuple(float(getattr(own, name)) for name in KINDS[kind]),
        shift=(ob.data.shift_x, ob.data.shift_y),
        pixel=(pixel, pixel * frame.pixel_aspect_y / frame.pixel_aspect_x),
    )
