"""Reference blur: the convolution of a picture with a Gaussian, differentiable by autograd.

Source: Geusebroek, Smeulders and van de Weijer 2003, Fast Anisotropic Gauss Filtering.
"""

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from ...shared_constants import BLUR_REACH

_Tap = tuple[int, int, float]
"""Offsets in x and y, and weight."""


def blur_reference(image: Tensor, covariance: Sequence[float]) -> Tensor:
    """Blur a picture, [H, W, C] of any dtype, by a Gaussian with variances xx, xy, yy, px^2.

    The first pass is along the line (k, s k) over columns k or (s k, k) over rows k, whichever
    variance is larger, with s = xy over it and values interpolated between two pixels; the second
    along the other axis, with the rest of the variance. Weights beyond the picture are left out;
    the others add up to 1.
    """
    xx, xy, yy = covariance
    down, longer = yy > xx, max(xx, yy)
    slope = xy / longer if longer > 0 else 0.0
    rest = max(min(xx, yy) - slope * xy, 0.0)
    return _blur_pass(_blur_pass(image, _taps(longer, slope, down)), _taps(rest, 0.0, not down))


def _taps(variance: float, slope: float, down: bool) -> list[_Tap]:
    """Taps along a line, of rows if `down`, else of columns."""
    reach = math.ceil(BLUR_REACH * math.sqrt(variance))
    weights = {k: math.exp(-0.5 * k * k / variance) if k else 1.0 for k in range(-reach, reach + 1)}
    taps: list[_Tap] = []
    for k, weight in weights.items():
        across = math.floor(slope * k)
        share = slope * k - across
        for j, part in ((across, 1 - share), (across + 1, share)):
            taps.append((*((j, k) if down else (k, j)), weight * part / sum(weights.values())))
    return taps


def _blur_pass(image: Tensor, taps: list[_Tap]) -> Tensor:
    """Weighted mean over those taps of each pixel that are in the picture."""
    height, width = image.shape[:2]
    rows, columns = torch.arange(height)[:, None], torch.arange(width)
    total, weights = torch.zeros_like(image), torch.zeros_like(image[..., :1])
    for dx, dy, weight in taps:
        y, x = rows + dy, columns + dx
        inside = ((y >= 0) & (y < height) & (x >= 0) & (x < width))[..., None] * weight
        total = total + inside * image[y.clamp(0, height - 1), x.clamp(0, width - 1)]
        weights = weights + inside
    return total / weights
