"""Dropout of splats in a step (Park et al. 2025, DropGaussian)."""

import torch

_GONE = -30.0
"""Logit of a dropped splat: far below the opacity at which splats are drawn."""
_MOST = 0.999
"""Highest opacity after compensation; the rasterizer clamps to 0.99 anyway."""


def drop_splats(opacities: torch.Tensor, rate: float, numbers: torch.Tensor) -> torch.Tensor:
    """Return the opacities of one step, some dropped and the others raised to compensate.

    The opacity o of a splat that stays becomes o / (1 - rate), which keeps the expected sum of
    opacities (Park et al. 2025, DropGaussian, eq. 4).

    Args:
        opacities: [N] logits.
        rate: Share of splats to drop, in [0, 1).
        numbers: [N] uniform in [0, 1); splats with less than `rate` are dropped.

    Returns:
        [N] logits, differentiable in `opacities`. Dropped splats receive no gradient; the clamp at
        the highest opacity passes gradients through, so that these splats can fade again.
    """
    stays = numbers >= rate
    raised = torch.sigmoid(opacities) / (1 - rate)
    raised = raised - (raised - _MOST).clamp_min(0).detach()
    return torch.where(stays, torch.logit(raised), _GONE)
