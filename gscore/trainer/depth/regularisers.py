"""Regularisers: random dropout of splats, and opacity losses inside masks or everywhere."""

import numpy as np
import torch

from ...config import TrainConfig
from ...engine.random import uniform
from ..schedule.caps import drops_splats_of_subject

_GONE = -30.0
"""Logit of a dropped splat: far below the opacity at which splats are drawn."""
_MOST = 0.999
"""Highest opacity after compensation; the rasterizer clamps to 0.99 anyway."""


def drop_rate_of(config: TrainConfig, *, known: float | None, mask_mode: str) -> tuple[float, str]:
    """Return the dropout rate of the last step for these photos.

    Args:
        config: `drop_rate`, and its condition `drop_below`.
        known: Share of the unmasked pixels with a depth by stereo; None: stereo has not run.
        mask_mode: Use of the masks, as `Dataset.mask_mode`.

    Returns:
        The rate in [0, 1), and a message if a condition led to it; otherwise empty.
    """
    rate = config.drop_rate
    if not (rate and config.drop_below):
        return rate, ""
    if mask_mode == "composite":
        if not drops_splats_of_subject(config, mask_mode=mask_mode, known=known):
            return 0.0, ""
        why = f"Photos agree on the depth of {known:.0%} of the subject's pixels"
    elif known is None or known >= config.drop_below:
        return 0.0, ""
    else:
        why = f"Photos agree on the depth of {known:.0%} of their pixels"
    return rate, (
        f"{why}, so steps drop up to {rate:.0%} of the splats, which improves unseen views "
        "(`--drop-rate 0` drops none)."
    )


def drop_rate_at(rate: float, step: int, iterations: int) -> float:
    """Dropout rate of `step`: rises linearly to `rate` (Park et al. 2025, eq. 5)."""
    return rate * min(step / iterations, 1.0)


def drop_splats(opacities: torch.Tensor, rate: float, generator: torch.Generator) -> torch.Tensor:
    """Return the opacities of one step, some dropped and the others raised to compensate.

    The opacity o of a splat that stays becomes o / (1 - rate), which keeps the expected sum of
    opacities (Park et al. 2025, DropGaussian, eq. 4).

    Args:
        opacities: [N] logits.
        rate: Share of splats to drop, in [0, 1).
        generator: Source of one random number per splat.

    Returns:
        [N] logits, differentiable in `opacities`. Dropped splats receive no gradient; the clamp at
        the highest opacity passes gradients through, so that these splats can fade again.
    """
    stays = uniform(len(opacities), generator) >= rate
    raised = torch.sigmoid(opacities) / (1 - rate)
    raised = raised - (raised - _MOST).clamp_min(0).detach()
    return torch.where(stays, torch.logit(raised), _GONE)


def opacity_loss(alpha: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
    """Mean absolute difference of rendered opacity and mask.

    Args:
        alpha: [H, W] float; differentiable.
        mask: [H, W] uint8, 255 = opaque.
    """
    return (alpha - mask.to(alpha.dtype) * (1 / 255)).abs().mean()


def mean_transmittance(alpha: torch.Tensor, mask: np.ndarray | None) -> tuple[float, torch.Tensor]:
    """Mean transmittance of a view, and its gradient in `alpha`: a loss for opaque scenes.

    Over a black background black pixels need no splat, and 1 to 7 % of the light of whole captures
    passes between the splats (docs/experiments).

    Args:
        alpha: [H, W] float, rendered opacity.
        mask: [H, W] uint8, weight of each pixel, 255 = 1; None: 1 everywhere.

    Returns:
        The mean of (1 - alpha) mask / 255 over all pixels, and [H, W] of alpha's dtype.
    """
    if mask is None:
        slope = torch.full_like(alpha, -1 / alpha.numel())
    else:
        slope = torch.from_numpy(mask).to(alpha.dtype) * (-1 / (255 * alpha.numel()))
    return float(((alpha - 1) * slope).sum()), slope
