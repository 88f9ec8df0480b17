"""Photo poses: refinement of training camera poses together with the splats."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...events import Decision
from ...raster.request import Frustum
from .photo_adam import PhotoAdam, checked_array, rate_at
from .pose_math import moved_pose, pose_distances, pose_gradient

LIMIT = 0.05
"""Largest change of a refined camera from its initial pose: rad, and shares of the extent."""
_NAME = "pose"
"""Prefix of the arrays in checkpoints."""


@dataclass(frozen=True, kw_only=True)
class PoseCheck:
    """Checked poses of the training cameras."""

    viewmats: np.ndarray | None = None
    """[V, 4, 4] float64, world to camera, of all views, if training cameras were realigned or are
    refined; None: the poses of the capture."""
    learns: bool = False
    """True if poses are refined from the photos during the training."""
    decision: Decision | None = None
    """The decision and its reason; None: no check."""


class PhotoPoses:
    """Poses of the training photos in the training frame; held-out cameras are fixed.

    A common motion of all cameras would only move the scene relative to held-out cameras, so the
    mean motion of each step is removed, to first order, from all of them.
    """

    def __init__(
        self,
        train: Sequence[int],
        viewmats: np.ndarray,
        *,
        unit: float,
        limit: float = LIMIT,
        learns: bool = True,
    ) -> None:
        """Create poses that start at `viewmats`.

        Args:
            train: Views whose poses are optimised.
            viewmats: [V, 4, 4] float64, world to camera, of all views.
            unit: Translation equivalent to a rotation by 1 rad: about the distance of cameras from
                the scene, training units.
            limit: Largest change of a camera from its initial pose, rad and `unit`.
            learns: Whether the poses are refined; False: only stored.
        """
        self._train = np.array(train, np.int64)
        self._first, self._viewmats = viewmats.copy(), viewmats.copy()
        self._unit, self._limit = unit, limit
        self.learns = learns
        """True if the poses are refined; False: only stored."""
        self._adam = PhotoAdam(len(viewmats), 6)

    @property
    def viewmats(self) -> np.ndarray:
        """[V, 4, 4] float64, world to camera; do not write to it."""
        return self._viewmats

    def of(self, index: int) -> np.ndarray:
        """Pose of view `index`, world to camera, [4, 4] float32."""
        return self._viewmats[index].astype(np.float32)

    def learn(self, index: int, v_viewmat: np.ndarray, rate: float) -> None:
        """Adam step for the pose of one photo, in its tangent space.

        Args:
            index: Training view.
            v_viewmat: [4, 4] derivative of the loss in the pose; skipped unless finite.
            rate: Learning rate, rad and `unit`.
        """
        before = self._viewmats[index].copy()
        scale = np.repeat([1.0, self._unit], 3)
        grad = pose_gradient(before, v_viewmat.astype(np.float64)) * scale
        if not np.isfinite(grad).all():
            return
        motion = self._adam.step(index, grad, rate) * scale
        self._viewmats[index] = self._limited(index, moved_pose(before, motion))
        self._remove_mean(np.linalg.inv(before) @ self._viewmats[index])

    def _limited(self, index: int, pose: np.ndarray) -> np.ndarray:
        """`pose`, or the camera's current pose if `pose` is beyond the limit."""
        angle, distance = pose_distances(pose[None], self._first[index][None])
        far = angle[0] > self._limit or distance[0] > self._limit * self._unit
        return self._viewmats[index] if far else pose

    def _remove_mean(self, motion: np.ndarray) -> None:
        """Remove the mean over all cameras of a motion of one, [4, 4] in the world."""
        turn, count = motion[:3, :3], len(self._train)
        axis = [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
        mean = np.concatenate([np.array(axis) / 2, motion[:3, 3]]) / count
        self._viewmats[self._train] = self._viewmats[self._train] @ moved_pose(np.eye(4), -mean)

    def arrays(self) -> dict[str, np.ndarray]:
        """State by name; no copies."""
        return {
            f"{_NAME}/viewmats": self._viewmats,
            f"{_NAME}/first": self._first,
            f"{_NAME}/facts": np.array([self._unit, self._limit, float(self.learns)]),
        } | self._adam.arrays(_NAME)

    @staticmethod
    def are_in(arrays: Mapping[str, np.ndarray]) -> bool:
        """Return whether a checkpoint has poses."""
        return f"{_NAME}/viewmats" in arrays

    @classmethod
    def restored(
        cls, train: Sequence[int], views: int, arrays: Mapping[str, np.ndarray]
    ) -> "PhotoPoses":
        """Restore the poses of `views` photos from the arrays of a checkpoint.

        Raises:
            ValueError, KeyError: the arrays are invalid.
        """
        first = checked_array(f"{_NAME}/first", arrays, (views, 4, 4))
        unit, limit, learns = checked_array(f"{_NAME}/facts", arrays, (3,)).tolist()
        out = cls(train, first, unit=unit, limit=limit, learns=learns == 1)
        out._viewmats = checked_array(f"{_NAME}/viewmats", arrays, (views, 4, 4))
        out._adam.restore(_NAME, arrays)
        return out


_STEPS = 60
_RATES = 2e-3, 5e-5
"""Learning rate of the first step and of the last, rad and units."""


def align_pose(
    gradient: Callable[[Frustum], np.ndarray], view: Frustum, *, unit: float
) -> np.ndarray:
    """Return the camera pose, [4, 4] float32, that minimises the photo's loss for fixed splats.

    Args:
        gradient: Returns the gradient of the loss in a view's pose, [4, 4] float32.
        view: The view.
        unit: Translation equivalent to a rotation by 1 rad, world units of the view.
    """
    adam, scale = PhotoAdam(1, 6), np.repeat([1.0, unit], 3)
    pose = np.asarray(view.viewmat, np.float64)
    for step in range(_STEPS):
        v_viewmat = gradient(replace(view, viewmat=pose.astype(np.float32))).astype(np.float64)
        grad = pose_gradient(pose, v_viewmat) * scale
        if not np.isfinite(grad).all():
            break
        pose = moved_pose(pose, adam.step(0, grad, rate_at(*_RATES, step / _STEPS)) * scale)
    return pose.astype(np.float32)
