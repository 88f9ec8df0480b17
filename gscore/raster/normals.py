"""Normals of splats as a differentiable picture: a picture whose colours are the normals."""

from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..shared_constants import SH_C0
from .autograd import rasterize
from .reference.geometry import quat_to_rotmat


class NormalPicture(NamedTuple):
    """Normals of a view, differentiable."""

    normals: Tensor
    """[H, W, 3], sum of weight times unit normal, camera axes."""
    alpha: Tensor
    """[H, W]."""
    inverse_depth: Tensor | None = None
    """[H, W], as of `RasterOutput`; None unless requested."""
    depth: Tensor | None = None
    """[H, W], as of `RasterOutput`; None unless requested."""


def rasterize_normals(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    viewmat: Tensor,
    K: Tensor,
    width: int,
    height: int,
    **how: Any,
) -> NormalPicture:
    """Render the normals of splats from one pinhole camera; see `splat_normals` of `api`.

    Normals are colours of `rasterize`, so every device draws them, and its gradients reach quats
    through the normals, and means, quats, scales and opacities through the weights. Which axis is
    the shortest and which side is seen have no gradient.

    Args:
        means: As for `rasterize`.
        quats: As for `rasterize`.
        scales: As for `rasterize`.
        opacities: As for `rasterize`.
        viewmat: As for `rasterize`.
        K: As for `rasterize`.
        width: As for `rasterize`.
        height: As for `rasterize`.
        **how: Other arguments of `rasterize`: raw, near, antialias, threads, device, inverse_depth,
            depth and more; no background.

    Returns:
        Normals, alpha and the requested depths.

    Raises:
        As `rasterize`.
    """
    normals = oriented_normals(means, quats, scales, viewmat)
    sh0 = normals[:, None] / (2 * SH_C0)  # colours of (normal + 1) / 2, which are not below 0
    drawn = rasterize(
        *(means, quats, scales, opacities, sh0, sh0.new_zeros(len(sh0), 0, 3)),
        *(viewmat, K, width, height),
        **how,
    )
    normals = 2 * drawn.rgb - drawn.alpha[..., None]
    return NormalPicture(normals, drawn.alpha, drawn.inverse_depth, drawn.depth)


def oriented_normals(means: Tensor, quats: Tensor, scales: Tensor, viewmat: Tensor) -> Tensor:
    """[N, 3], the shortest axis of each splat, turned to the camera; unit length, camera axes.

    Args:
        means: [N, 3], world.
        quats: [N, 4], wxyz, of any non-zero length.
        scales: [N, 3], logarithms or standard deviations.
        viewmat: [4, 4], world to camera, OpenCV axes.
    """
    axes = quat_to_rotmat(quats)
    shortest = scales.argmin(dim=1)
    normals = (
        axes[torch.arange(len(axes), dtype=torch.int64, device=axes.device), :, shortest]
        @ viewmat[:3, :3].T
    )
    with torch.no_grad():
        places = means @ viewmat[:3, :3].T + viewmat[:3, 3]
        away = (places * normals).sum(dim=1, keepdim=True) > 0
    return torch.where(away, -normals, normals)
