"""Pose check: training cameras against their tracks, with realignment."""

from collections.abc import Sequence

import numpy as np

from ...config import Switch, TrainConfig
from ...datasets.tracks import Tracks
from ...events import Decision
from ...text_format import count_text
from ..photos.view_sampler import Photos
from ..views.photo_poses import PoseCheck
from .analysis import Analysis
from .resection import PointObservations, median_residual, resection_pose

BAD = 2.0
"""Median reprojection error above which a camera pose is wrong, in pixels of a photo of 1,000 px.
Structure from motion leaves 0.4 to 1.4."""
_BETTER = 0.5
"""Largest error of an accepted new pose relative to the old one."""
_DOUBT = 0.1
"""Share of training cameras with a wrong pose after resection above which poses are refined from
the photos; a smaller share may just have wrong points."""
_REQUESTED = Decision("poses", "Training poses are refined (requested).")


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
