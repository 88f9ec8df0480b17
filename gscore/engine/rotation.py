"""Rotations by quaternions."""

import torch

from ..shared_constants import QUAT_MIN


def rotate(quats: torch.Tensor, vectors: torch.Tensor) -> torch.Tensor:
    """Rotate vectors [M, 3] by quaternions [M, 4] wxyz of any non-zero length."""
    unit = quats / quats.square().sum(dim=1, keepdim=True).sqrt().clamp_min(1e-12)
    axis, w = unit[:, 1:], unit[:, :1]
    # v + 2 w (u x v) + 2 u x (u x v)
    cross = torch.linalg.cross(axis, vectors)
    return vectors + 2 * (w * cross + torch.linalg.cross(axis, cross))


def undirected(quats: torch.Tensor) -> torch.Tensor:
    """Return [N] bool: quaternions, [N, 4], too short for the rasterizer to draw their splats."""
    return quats.abs().amax(dim=1) < QUAT_MIN
