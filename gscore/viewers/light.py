"""sRGB values to linear light and back (IEC 61966-2-1), differentiable."""

import torch
from torch import Tensor


def to_linear(srgb: Tensor) -> Tensor:
    """Linear light of sRGB values from 0; values above 1 continue the curve."""
    curve = ((srgb.clamp(min=0.04045) + 0.055) / 1.055) ** 2.4
    return torch.where(srgb <= 0.04045, srgb / 12.92, curve)


def to_srgb(linear: Tensor) -> Tensor:
    """sRGB values of linear light from 0; values above 1 continue the curve."""
    curve = 1.055 * linear.clamp(min=0.0031308) ** (1 / 2.4) - 0.055
    return torch.where(linear <= 0.0031308, linear * 12.92, curve)
