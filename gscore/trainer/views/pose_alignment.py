"""Pose alignment: optimisation of a camera pose for trained splats to match a photo."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ...raster.request import Frustum
from .photo_adam import PhotoAdam, rate_at
from .pose_math import moved_pose, pose_gradient

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
