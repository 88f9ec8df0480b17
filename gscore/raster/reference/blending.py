"""Reference blending, front to back: every splat at every pixel, no tiles, no bounding boxes.

Source: Kerbl et al. 2023, equations 2 to 4 (C = sum_i T_i alpha_i c_i).
"""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from ...shared_constants import ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN

STOP_AT = TRANSMITTANCE_MIN * (1 + 1e-9)
"""The limit of the transmittance with a tolerance: two splats capped at 0.99 leave exactly 1e-4,
which must stop the pixel although (1 - 0.99)^2 rounds to slightly more."""

PAIRS_PER_CHUNK = 1 << 18
"""Splat-pixel pairs per chunk: limits memory to about a hundred megabytes in float64."""


class Blended(NamedTuple):
    """Result of blending at P pixels."""

    sums: Tensor
    """[P, F], sum of weight times feature."""
    transmittance: Tensor
    """[P], final transmittance."""
    median_depth: Tensor
    """[P], z of the splat that brings the transmittance to 0.5 or below; 0 if none does."""


def pixel_centers(width: int, height: int, like: Tensor) -> Tensor:
    """Coordinates of the pixel centres, row by row: [height * width, 2] as (x, y), pixels."""
    y, x = torch.meshgrid(
        torch.arange(height, dtype=like.dtype, device=like.device) + 0.5,
        torch.arange(width, dtype=like.dtype, device=like.device) + 0.5,
        indexing="ij",
    )
    return torch.stack([x, y], -1).reshape(-1, 2)


def gaussian_alpha(pixels: Tensor, means2d: Tensor, conics: Tensor, opacities: Tensor) -> Tensor:
    """Opacity of M splats at P pixels before the cap (Kerbl et al. 2023, equation 4, in the image).

    Args:
        pixels: [P, 2], pixel centres.
        means2d: [M, 2], pixels.
        conics: [M, 3], inverse covariance (xx, xy, yy).
        opacities: [M], activated and compensated.

    Returns:
        [P, M], opacity * exp(-d^T conic d / 2).
    """
    dx, dy = (pixels[:, None, :] - means2d).unbind(-1)  # [P, M]
    xx, xy, yy = conics.unbind(-1)  # [M]
    half_distance2 = 0.5 * (xx * dx * dx + yy * dy * dy) + xy * dx * dy
    return opacities * torch.exp(-half_distance2)


def blend_pixels(
    pixels: Tensor,
    means2d: Tensor,
    conics: Tensor,
    opacities: Tensor,
    depths: Tensor,
    features: Tensor,
    far_depths: Tensor | None = None,
) -> Blended:
    """Blend M splats, given front to back, at P pixels.

    Differentiable in all but `pixels`; the cap on alpha passes no gradient to the splat's shape,
    position and opacity, and the median depth passes none at all.

    Args:
        pixels: [P, 2], pixel centres.
        means2d: [M, 2], pixels.
        conics: [M, 3].
        opacities: [M].
        depths: [M], camera z, ascending.
        features: [M, F], values to sum: colour, depth, one.
        far_depths: [P], splats with z above it are not drawn at a pixel; NaN or None: all are.

    Returns:
        The sums, the final transmittance and the median depth.
    """
    uncapped = gaussian_alpha(pixels, means2d, conics, opacities)  # [P, M]
    alpha = torch.where(uncapped < ALPHA_MAX, uncapped, ALPHA_MAX)
    alpha = torch.where(uncapped >= ALPHA_MIN, alpha, 0.0)
    if far_depths is not None:
        alpha = torch.where(depths > far_depths[:, None], 0.0, alpha)

    # Transmittance never increases, so the splats before the stop are those after which it is still
    # above the limit.
    keep = torch.cumprod(1 - alpha, 1).detach() > STOP_AT
    alpha = torch.where(keep, alpha, 0.0)

    after = torch.cumprod(1 - alpha, 1)  # [P, M], transmittance behind each splat
    light = torch.cat([after.new_ones(len(pixels), 1), after], 1)  # [P, M + 1]
    before = light[:, :-1]
    weights = alpha * before

    crossing = (before > 0.5) & (after <= 0.5)  # at most one splat a pixel
    median_depth = crossing.to(depths.dtype) @ depths.detach()
    return Blended(weights @ features, light[:, -1], median_depth)


def blend(
    means2d: Tensor,
    conics: Tensor,
    opacities: Tensor,
    depths: Tensor,
    features: Tensor,
    *,
    width: int,
    height: int,
    far_depths: Tensor | None = None,
    pairs_per_chunk: int = PAIRS_PER_CHUNK,
) -> Blended:
    """`blend_pixels` over a whole image, a few rows at a time, recomputed in the backward pass.

    Args:
        means2d: [M, 2], pixels.
        conics: [M, 3].
        opacities: [M].
        depths: [M], camera z, ascending.
        features: [M, F].
        width: pixels.
        height: pixels.
        far_depths: [H, W], as for `blend_pixels`.
        pairs_per_chunk: memory limit; does not change the result.

    Returns:
        The fields of `Blended` for P = height * width pixels, row by row.
    """
    pixels = pixel_centers(width, height, like=means2d)
    chunk = max(1, pairs_per_chunk // max(1, len(means2d)))
    far = pixels.new_full((len(pixels),), torch.nan)
    if far_depths is not None:
        far = far_depths.to(far).reshape(-1)
    splats = means2d, conics, opacities, depths, features
    parts = [
        # Recomputing a chunk in the backward pass keeps only its inputs alive.
        checkpoint(blend_pixels, part, *splats, limits, use_reentrant=False)
        for part, limits in zip(pixels.split(chunk), far.split(chunk), strict=True)
    ]
    return Blended(*(torch.cat(field) for field in zip(*parts, strict=True)))
