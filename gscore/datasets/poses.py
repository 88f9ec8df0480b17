"""Poses and intrinsics of capture files, validated, and warnings on unlikely ones."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from ..errors import FormatError
from ..io.colmap.model import ColmapCamera
from ..quoting import first_few, quoted
from ..scene import FARTHEST, FOCAL_RANGE, Scene, distances, is_focal
from ..text_format import count_text, number

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


_STRAY = 100.0
"""Distance from the middle of the cameras from which it is reported, in medians."""
_OFF_AXIS = 10.0
"""Distance of the principal point from the image centre from which it is reported, in image
sizes."""


def position_warnings(scene: Scene) -> Iterator[str]:
    """Warnings about cameras and points far from all others, which distort the scene's size."""
    centers = scene.cameras.centers
    middle = np.median(centers, axis=0)
    far, times = _far(centers, middle)
    if len(far):
        names = first_few([scene.cameras.names[i] for i in far])
        yield (
            f"{names}: {times:.0f} times farther from the other cameras than these from each "
            "other. Sizes and learning rates depend on the farthest camera; leave such views out."
        )
    far, times = _far(scene.points.points, middle)
    if len(far) > 0.001 * len(scene.points):
        yield (
            f"{number(len(far))} of {count_text(len(scene.points), 'point')} are more than "
            f"{_STRAY:.0f} times farther from the cameras than half of the points."
        )


def _far(positions: np.ndarray, middle: np.ndarray) -> tuple[np.ndarray, float]:
    """Indices of positions [N, 3] beyond _STRAY median distances from `middle`, and the largest
    distance in medians."""
    distance = distances(positions, middle)
    median = float(np.median(distance)) if len(distance) else 0.0
    if len(distance) < 4 or not median > 0:
        return np.zeros(0, np.intp), 0.0
    return np.flatnonzero(distance > _STRAY * median), float(distance.max()) / median


def axis_warnings(scene: Scene) -> Iterator[str]:
    """Warning about cameras whose optical axis passes far outside their picture, farther than any
    shifted lens."""
    cameras = scene.cameras
    sizes = np.stack([cameras.widths, cameras.heights], axis=1)
    off = np.abs(cameras.Ks[:, :2, 2] / sizes - 0.5).max(axis=1)
    wrong = np.flatnonzero(off > _OFF_AXIS)
    if len(wrong):
        names = first_few([cameras.names[i] for i in wrong])
        yield (
            f"{names}: the principal point is {off.max():.0f} times the picture's size from its "
            "middle; no lens does that. Check the intrinsics."
        )
