"""Regularisers: random dropout of splats, and opacity losses inside masks or everywhere."""

import numpy as np
import torch

from ...config import TrainConfig
from ..host.random import uniform
from ..schedule.caps import drops_splats_of_subject

_GONE = -30.0
"""Logit of a splat that is left out: far below the opacity at which one is drawn."""
_MOST = 0.999
"""Highest opacity that making up for the others leads to; no more than 0.99 is drawn anyway."""


def drop_rate_of(config: TrainConfig, *, known: float | None, mask_mode: str) -> tuple[float, str]:
    """The share of splats that a run leaves out of its last step, for these photos.

    Args:
        config: `drop_rate`, and `drop_below`, its condition.
        known: Share of the pixels that masks leave whose depth stereo found; None: nobody
            looked.
        mask_mode: What masks are for, as `Dataset.mask_mode`.

    Returns:
        The share, and a sentence where a condition holds; empty where there is none.
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
        f"{why}: of each step as many as {rate:.0%} of the splats are left out, for unseen views "
        "(--drop-rate 0 leaves out none)."
    )


def drop_rate_at(rate: float, step: int, iterations: int) -> float:
    """Share of splats to leave out of `step`: rises evenly to `rate` (Park et al. 2025, eq. 5)."""
    return rate * min(step / iterations, 1.0)


def drop_splats(opacities: torch.Tensor, rate: float, generator: torch.Generator) -> torch.Tensor:
    """Opacities for one step, some gone and the others raised to make up for them.

    The opacity o of a splat that stays becomes o / (1 - rate), so that the expected sum of
    opacities stays (Park et al. 2025, DropGaussian, eq. 4).

    Args:
        opacities: [N] logits.
        rate: Share to leave out, in [0, 1).
        generator: One number a splat is drawn from it.

    Returns:
        [N] logits, differentiable in `opacities`; those left out get no gradient, those that reach
        the ceiling get one as if there were none, or they could never fade again.
    """
    stays = uniform(len(opacities), generator) >= rate
    raised = torch.sigmoid(opacities) / (1 - rate)
    raised = raised - (raised - _MOST).clamp_min(0).detach()
    return torch.where(stays, torch.logit(raised), _GONE)


def opacity_loss(alpha: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
    """Mean absolute difference of rendered opacity and mask.

    Args:
        alpha: [H, W] float; differentiable in it.
        mask: [H, W] uint8, 255 = opaque.
    """
    return (alpha - mask.to(alpha.dtype) * (1 / 255)).abs().mean()


def see_through(alpha: torch.Tensor, mask: np.ndarray | None) -> tuple[float, torch.Tensor]:
    """Mean share of light that passes between the splats, and its gradient in `alpha`.

    Over a black background what is black is right without any splat, and 1 to 7 % of the light of
    whole captures passes (docs/experiments). This asks that photos of a scene be opaque.

    Args:
        alpha: [H, W] float, rendered opacity.
        mask: [H, W] uint8, how much each pixel counts, 255 = whole; None: all do.

    Returns:
        The mean of (1 - alpha) mask / 255 over all pixels, and [H, W] of alpha's dtype.
    """
    if mask is None:
        slope = torch.full_like(alpha, -1 / alpha.numel())
    else:
        slope = torch.from_numpy(mask).to(alpha.dtype) * (-1 / (255 * alpha.numel()))
    return float(((alpha - 1) * slope).sum()), slope
