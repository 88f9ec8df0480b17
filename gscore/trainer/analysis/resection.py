"""Resection: camera poses from the SfM points observed in their photos."""

from dataclasses import dataclass

import numpy as np

from ...transforms import SMALLEST
from ..views.pose_math import cross_matrix, moved_pose

_ROUNDS = 15
"""Gauss-Newton iterations."""
_LEAST = 12
"""Least points for a resection."""
_TUNING = 2.0
"""Scale of the Cauchy weights, in median residuals."""
_FLOOR = 1e-4
"""Smallest scale of residuals, x / z: a tenth of a pixel of a photo of 1,000 px."""


@dataclass(frozen=True, kw_only=True)
class PointObservations:
    """Observations of 3D points in one camera."""

    points: np.ndarray
    """[M, 3] float64, world units."""
    rays: np.ndarray
    """[M, 2] float64, x / z and y / z."""


def residuals(viewmat: np.ndarray, observed: PointObservations) -> np.ndarray:
    """Return [M, 2]: reprojected minus observed x / z and y / z; NaN behind the camera."""
    local = observed.points @ viewmat[:3, :3].T + viewmat[:3, 3]
    z = np.where(local[:, 2] > 0, local[:, 2], np.nan)
    return local[:, :2] / z[:, None] - observed.rays


def median_residual(viewmat: np.ndarray, observed: PointObservations) -> float:
    """Median length of the residuals, x / z; infinite without points."""
    length = np.linalg.norm(residuals(viewmat, observed), axis=1)
    return (
        float(np.median(np.where(np.isfinite(length), length, np.inf))) if len(length) else np.inf
    )


def resection_pose(viewmat: np.ndarray, observed: PointObservations) -> np.ndarray:
    """Return the camera pose, [4, 4], of the smallest reprojection error; the given one with fewer
    than twelve points or if no better pose is found.

    Iteratively reweighted least squares over the motion of `moved_pose`, with Cauchy weights.
    """
    if len(observed.points) < _LEAST:
        return viewmat
    pose = viewmat
    for _ in range(_ROUNDS):
        step = _step(pose, observed)
        if step is None:
            break
        pose = moved_pose(pose, step)
        if np.abs(step).max() < 1e-9:
            break
    better = median_residual(pose, observed) < median_residual(viewmat, observed)
    return pose if better and np.isfinite(pose).all() else viewmat


def _step(pose: np.ndarray, observed: PointObservations) -> np.ndarray | None:
    """Motion [6] of one Gauss-Newton step; None without a solution."""
    off = residuals(pose, observed)
    depths = observed.points @ pose[2, :3] + pose[2, 3]
    good = np.isfinite(off).all(axis=1) & (np.abs(depths) > SMALLEST)
    if good.sum() < _LEAST:
        return None
    local = observed.points[good] @ pose[:3, :3].T + pose[:3, 3]
    off = off[good]
    length = np.linalg.norm(off, axis=1)
    scale = _TUNING * max(float(np.median(length)), _FLOOR)
    weight = 1 / (1 + (length / scale) ** 2)
    by_place = np.zeros((len(local), 2, 3))
    by_place[:, 0, 0] = by_place[:, 1, 1] = 1 / local[:, 2]
    by_place[:, :, 2] = -local[:, :2] / local[:, 2:] ** 2
    by_motion = np.concatenate([by_place @ -cross_matrix(local), by_place], axis=2)
    weighted = (by_motion * weight[:, None, None]).reshape(-1, 6)
    try:
        return np.linalg.solve(weighted.T @ by_motion.reshape(-1, 6), -weighted.T @ off.ravel())
    except np.linalg.LinAlgError:
        return None
