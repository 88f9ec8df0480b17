"""Pose alignment: optimisation of a camera pose for trained splats to match a photo."""

from collections.abc import Mapping

import numpy as np
import torch

from ...raster.loss import image_loss_gradient
from ...raster.memory import empty, zeros
from ...raster.request import Frustum, Settings
from ...raster.training_rasterizer import TrainingRasterizer
from ..photos.image_pyramid import SizedView
from .photo_adam import PhotoAdam, rate_at
from .pose_math import moved_pose, pose_gradient

_STEPS = 60
_RATES = 2e-3, 5e-5
"""Learning rate of the first step and of the last, rad and units."""


def align_pose(
    splats: Mapping[str, torch.Tensor],
    sized: SizedView,
    settings: Settings,
    *,
    mask_mode: str,
    unit: float,
) -> torch.Tensor:
    """Return the camera pose, [4, 4] float32, that minimises the photo's loss for fixed splats.

    Args:
        splats: Raw parameters by name.
        sized: View with its photo and mask.
        settings: Render settings.
        mask_mode: Meaning of the mask.
        unit: Translation equivalent to a rotation by 1 rad, world units of the view.
    """
    rasterizer, adam, scale = TrainingRasterizer(), PhotoAdam(1, 6), np.repeat([1.0, unit], 3)
    into = {name: zeros(*t.shape) for name, t in splats.items()}
    pose, v_viewmat = sized.view.viewmat.numpy().astype(np.float64), empty(4, 4)
    target, mask = torch.from_numpy(sized.image), sized.mask
    v_rgb = empty(*sized.image.shape)
    for step in range(_STEPS):
        view = _from(sized.view, pose)
        picture = rasterizer.draw(tuple(splats.values()), view, settings)
        image_loss_gradient(
            picture.rgb,
            target,
            v_rgb,
            mask=None if mask is None else torch.from_numpy(mask),
            mask_mode="none" if mask is None else mask_mode,
            background=settings.background,
            threads=settings.threads,
        )
        rasterizer.gradients(into, v_rgb, viewmat=v_viewmat)
        grad = pose_gradient(pose, v_viewmat.numpy().astype(np.float64)) * scale
        if not np.isfinite(grad).all():
            break
        pose = moved_pose(pose, adam.step(0, grad, rate_at(*_RATES, step / _STEPS)) * scale)
    return _from(sized.view, pose).viewmat  # pyright: ignore[reportReturnType]


def _from(view: Frustum, pose: np.ndarray) -> Frustum:
    viewmat = torch.from_numpy(pose.astype(np.float32))
    return Frustum(viewmat, view.K, view.width, view.height, view.near, view.far)
