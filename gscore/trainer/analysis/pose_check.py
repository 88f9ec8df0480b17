"""Pose check: training cameras against their tracks, with realignment."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...config import Switch, TrainConfig
from ...datasets.tracks import Tracks
from ...events import Decision
from ...text_format import count_text
from ...transforms import SMALLEST
from ..photos.view_sampler import Photos
from ..views.photo_poses import PoseCheck
from ..views.pose_math import cross_matrix, moved_pose
from .analysis import Analysis

BAD = 2.0
"""Median reprojection error above which a camera pose is wrong, in pixels of a photo of 1,000 px.
Structure from motion leaves 0.4 to 1.4."""
_BETTER = 0.5
"""Largest error of an accepted new pose relative to the old one."""
_DOUBT = 0.1
"""Share of training cameras with a wrong pose after resection above which poses are refined from
the photos; a smaller share may just have wrong points."""
_REQUESTED = Decision("poses", "Training poses are refined (requested).")


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


def check_poses(config: TrainConfig, analysis: Analysis) -> PoseCheck:
    """Compare the training cameras with their tracks, and decide on realignment and refinement."""
    if config.refine_poses is Switch.OFF:
        return PoseCheck()
    photos, tracks = analysis.photos, analysis.facts.tracks
    forced = config.refine_poses is Switch.ON
    viewmats = photos.scene.cameras.viewmats.copy()
    observed = _observations(photos, tracks) if tracks is not None else {}
    errors = {
        i: _pixels(photos, i, median_residual(viewmats[i], one)) for i, one in observed.items()
    }
    known = [error for error in errors.values() if np.isfinite(error)]
    if not known:
        return _unknown(viewmats, forced=forced)
    fact = f"{float(np.median(known)):.1f} px of 1,000"
    bad = [i for i, error in errors.items() if error > BAD]
    if not bad:
        if forced:
            return PoseCheck(viewmats=viewmats, learns=True, decision=_REQUESTED)
        why = f"Cameras agree with their points ({fact}), so their poses are unchanged."
        return PoseCheck(decision=Decision("poses", why))
    better = _realign(photos, observed, errors, viewmats, bad)
    left = len(bad) - better
    why = (
        f"{count_text(len(bad), 'training camera misses its', 'training cameras miss their')} "
        f"points (median of all {fact}): {better} realigned to them"
    )
    learns = forced or left > _DOUBT * len(photos.train)
    why += ", and poses are refined from the photos." if learns else "."
    return PoseCheck(viewmats=viewmats, learns=learns, decision=Decision("poses", why))


def _unknown(viewmats: np.ndarray, *, forced: bool) -> PoseCheck:
    if forced:
        return PoseCheck(viewmats=viewmats, learns=True, decision=_REQUESTED)
    return PoseCheck(
        decision=Decision(
            "poses",
            "No observed points can check the camera poses, so they are unchanged "
            "(`--refine-poses on` refines them).",
        )
    )


def _observations(photos: Photos, tracks: Tracks) -> dict[int, PointObservations]:
    """Observations of each training camera."""
    found = {}
    for i in photos.train:
        good = np.isfinite(tracks.rays[i]).all(axis=1)
        found[i] = PointObservations(
            points=tracks.points[tracks.observed[i][good]], rays=tracks.rays[i][good]
        )
    return found


def _realign(
    photos: Photos,
    observed: dict[int, PointObservations],
    errors: dict[int, float],
    viewmats: np.ndarray,
    bad: Sequence[int],
) -> int:
    """Realign cameras in `viewmats` where that reduces the error; return the number that are good
    afterwards."""
    count = 0
    for i in bad:
        pose = resection_pose(viewmats[i], observed[i])
        error = _pixels(photos, i, median_residual(pose, observed[i]))
        if error <= _BETTER * errors[i]:
            viewmats[i], count = pose, count + (error <= BAD)
    return count


def _pixels(photos: Photos, index: int, error: float) -> float:
    """Error in x / z, converted to pixels of a photo whose longer side is 1,000 px."""
    cameras = photos.scene.cameras
    side = max(cameras.widths[index], cameras.heights[index])
    return 1000 * error * float(cameras.Ks[index, 0, 0]) / float(side)
