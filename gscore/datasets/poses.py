"""Poses and intrinsics of capture files, validated."""

from typing import Any

import numpy as np

from ..errors import FormatError
from ..io.colmap.model import ColmapCamera
from ..quoting import quoted
from ..scene import FARTHEST, FOCAL_RANGE, is_focal

_SKEW = 1e-3
"""Largest skew, share of the focal length: residue of decomposing a float32 projection matrix."""


def rigid_matrix(where: str, key: str, value: Any) -> np.ndarray:
    """[4, 4] float64 rigid transform from 4 x 4 or 3 x 4 numbers, its rotation orthonormalised.

    Raises:
        FormatError: `value` has another shape, or scales, shears or mirrors.
    """
    matrix = _numbers(value)
    rotation = matrix[:3, :3] if matrix.shape in ((4, 4), (3, 4)) else np.zeros((3, 3))
    usable = (np.abs(matrix) <= FARTHEST).all()  # False for NaN
    # Exporters round to about 6 digits; an error above 1e-2 is a scaled or sheared camera.
    if not usable or np.abs(rotation.T @ rotation - np.eye(3)).max() > 1e-2:
        raise FormatError(
            f"{where}: {key} is {quoted(value)}, expected 4 x 4 numbers up to {FARTHEST:g}, a "
            f"rotation and a position. Remove the scale from the cameras and export it again."
        )
    if np.linalg.det(rotation) < 0:
        raise FormatError(f"{where}: {key} mirrors the camera. Export it again.")
    out = np.eye(4)
    out[:3] = matrix[:3]
    u, _, vt = np.linalg.svd(rotation)
    out[:3, :3] = u @ vt  # the nearest true rotation
    return out


def pinhole_camera(where: str, key: str, value: Any, width: int, height: int) -> ColmapCamera:
    """PINHOLE camera from 3 x 3 (or 4 x 4) intrinsics in pixels.

    Raises:
        FormatError: `value` is no such matrix, or has implausible focal lengths, skewed pixels, or
            a principal point outside the picture.
    """
    matrix = _numbers(value)
    K = matrix[:3, :3] if matrix.shape in ((3, 3), (4, 4)) else np.zeros((3, 3))
    fx, skew, cx, fy, cy = K[0, 0], K[0, 1], K[0, 2], K[1, 1], K[1, 2]
    good = (np.abs(K) <= FARTHEST).all() and fx > 0 and fy > 0 and np.allclose(K[2], [0, 0, 1])
    if not (good and K[1, 0] == 0 and abs(skew) <= _SKEW * fx):
        raise FormatError(
            f"{where}: {key} is {quoted(value)}, expected [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] in "
            f"pixels. Export the cameras again."
        )
    check_focal(f"{where}: {key}", (float(fx), float(fy)), width, height)
    if not (0 < cx < width and 0 < cy < height):
        raise FormatError(
            f"{where}: {key} has the principal point ({cx:g}, {cy:g}), outside the picture of "
            f"{width} x {height} pixels. The cameras belong to photos of another size."
        )
    return ColmapCamera(
        model="PINHOLE", width=width, height=height, params=np.array([fx, fy, cx, cy], np.float64)
    )


def check_focal(where: str, focal: tuple[float, float], width: float, height: float) -> None:
    """Raise FormatError for implausible focal lengths, in pixels, for a picture of this size."""
    if not all(is_focal(f, width, height) for f in focal):
        low, high = (limit * max(width, height) for limit in FOCAL_RANGE)
        raise FormatError(
            f"{where}: the focal lengths are {focal[0]:g} and {focal[1]:g} pixels for a picture of "
            f"{width:g} x {height:g}, expected {low:g} to {high:g}. Export the cameras again."
        )


def _numbers(value: Any) -> np.ndarray:
    try:
        return np.array(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        return np.zeros(0)
