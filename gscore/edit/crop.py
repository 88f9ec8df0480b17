"""Crop by splat centres: inside a box, an ellipsoid or the view of a camera."""

import numpy as np


def box_matrix(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """[4, 4] float64 that maps the box from `low` [3] to `high` [3], `low` < `high`, to the cube
    [-1, 1]^3."""
    low, high = np.asarray(low, np.float64), np.asarray(high, np.float64)
    half = (high - low) / 2
    matrix = np.diag([*(1 / half), 1.0])
    matrix[:3, 3] = -(low + high) / 2 / half
    return matrix


def sphere_matrix(center: np.ndarray, radius: float) -> np.ndarray:
    """[4, 4] float64 that maps a sphere around `center` [3] to the unit sphere."""
    center = np.asarray(center, np.float64)
    return box_matrix(center - radius, center + radius)


def in_unit_shape(points: np.ndarray, to_unit: np.ndarray, *, sphere: bool = False) -> np.ndarray:
    """Mask [N] bool of the points inside a box or ellipsoid, including its surface.

    Args:
        points: [N, 3].
        to_unit: [4, 4] float64 from the points' space to one in which the box is [-1, 1]^3.
        sphere: Test the ellipsoid inscribed in the box.
    """
    local = points @ to_unit[:3, :3].T + to_unit[:3, 3]
    if sphere:
        return (local * local).sum(axis=1) <= 1
    return np.abs(local).max(axis=1, initial=0) <= 1


def in_frustum(
    points: np.ndarray, K: np.ndarray, viewmat: np.ndarray, width: int, height: int, near: float
) -> np.ndarray:
    """Mask [N] bool of the points in a camera's picture.

    Args:
        points: [N, 3] world.
        K: [3, 3] pixels.
        viewmat: [4, 4] world to camera, OpenCV axes.
        width: Pixels.
        height: Pixels.
        near: Points with z at or below this are excluded; world units.
    """
    local = points @ viewmat[:3, :3].T + viewmat[:3, 3]
    z = local[:, 2]
    # Multiplied by z, to avoid a division.
    x, y = (local @ K[:2].T).T
    return (z > near) & (x >= 0) & (x <= width * z) & (y >= 0) & (y <= height * z)
