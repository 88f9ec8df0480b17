"""Splitting: the splats that replace one whose gradient is large."""

import math
from collections.abc import Mapping

import torch

from ...engine.random import gaussian
from ...engine.rotation import rotate

SPLIT_COUNT = 2
"""Number of splats that replace a split one (Kerbl et al. 2023, section 5.2)."""
SPLIT_SHRINK = 1.6
"""Divisor of the scales of split splats."""
HALF_OFFSET, HALF_LENGTH, HALF_WIDTH, HALF_OPACITY = 0.7, 0.5, 0.85, 0.6
"""Halves of a splat relative to it: distance from its centre and length along the longest axis,
width along the others, and opacity (factors of Deng et al. 2024; the distance was measured)."""


def split(
    params: Mapping[str, torch.Tensor], index: torch.Tensor, generator: torch.Generator
) -> dict[str, torch.Tensor]:
    """Return means and scales of the splats that replace the rows `index`, [M], in a split: drawn
    from their Gaussians, with scales divided by 1.6.

    Args:
        params: Raw parameters of all splats; means, quats and scales are read.
        index: Rows.
        generator: Source of the draw.

    Returns:
        SPLIT_COUNT * M rows by name.
    """
    means, quats, scales = (
        params[name][index].repeat(SPLIT_COUNT, 1) for name in ("means", "quats", "scales")
    )
    noise = gaussian(tuple(means.shape), generator)
    return {
        "means": means + rotate(quats, scales.exp() * noise),
        "scales": scales - math.log(SPLIT_SHRINK),
    }


def halve(params: Mapping[str, torch.Tensor], index: torch.Tensor) -> dict[str, torch.Tensor]:
    """Return means, scales and opacities of two halves of each row `index`, [M], next to each other
    along its longest axis. Together they render close to the splat, so that little must be trained
    again (Deng et al. 2024, Efficient Density Control for 3D Gaussian Splatting).

    Returns:
        SPLIT_COUNT * M rows by name: first all of one side, then of the other.
    """
    means, quats, scales, opacities = (
        params[name][index] for name in ("means", "quats", "scales", "opacities")
    )
    longest = torch.nn.functional.one_hot(scales.argmax(dim=1), 3).bool()
    offset = rotate(quats, HALF_OFFSET * scales.exp() * longest)
    length, width = (scales + math.log(f) for f in (HALF_LENGTH, HALF_WIDTH))
    scales = torch.where(longest, length, width)
    opacities = torch.logit(HALF_OPACITY * torch.sigmoid(opacities), eps=1e-6)
    halves = {"means": means, "scales": scales, "opacities": opacities}
    halves = {name: torch.cat([t, t]) for name, t in halves.items()}
    halves["means"] += torch.cat([offset, -offset])
    return halves
