"""Rotation of vectors by quaternions."""

import torch


def rotate(quats: torch.Tensor, vectors: torch.Tensor) -> torch.Tensor:
    """Rotate vectors [M, 3] by quaternions [M, 4] wxyz of any non-zero length."""
    unit = quats / quats.square().sum(dim=1, keepdim=True).sqrt().clamp_min(1e-12)
    axis, w = unit[:, 1:], unit[:, :1]
    # v + 2 w (u x v) + 2 u x (u x v)
    cross = torch.linalg.cross(axis, vectors)
    return vectors + 2 * (w * cross + torch.linalg.cross(axis, cross))
