"""Terms of a step on the splats themselves: dropout, and the noise and regularisers of MCMC
(Kheradmand et al. 2024, section 5)."""

import math
from collections.abc import Callable

import torch

from ...shared_constants import DROPOUT_ROWS
from ..rotation import rotate
from .model import CpuModel

GATE_SHARPNESS = 100.0
GATE_OPACITY = 0.005
"""Opacity around which noise fades out: sigmoid(-sharpness (opacity - GATE_OPACITY))."""
NOISE_MAX_OPACITY = 0.1
"""Opacity from which splats get no noise; the gate would leave less than 1e-4 of it."""


def add_regularisers(model: CpuModel, *, opacity_reg: float, scale_reg: float) -> None:
    """Add the gradients of opacity_reg * mean(opacity) + scale_reg * mean(scale)."""
    if len(model) == 0:
        return
    scales, grads = model.params["scales"], model.grads
    if opacity_reg:
        opacity = torch.sigmoid(model.params["opacities"])
        slope = opacity * (1 - opacity)
        grads["opacities"].add_(slope, alpha=opacity_reg / len(model))
    if scale_reg:
        grads["scales"].add_(scales.exp(), alpha=scale_reg / scales.numel())


def add_noise(
    model: CpuModel, weight: float, normal: Callable[[torch.Tensor], torch.Tensor]
) -> None:
    """Move faint splats by covariance @ noise times `weight`.

    `normal`: returns [M, 3] float32 normal numbers of rows, [M] int64.
    """
    opacities = model.params["opacities"]
    limit = math.log(NOISE_MAX_OPACITY / (1 - NOISE_MAX_OPACITY))
    faint = (opacities < limit).nonzero().flatten()
    if len(faint) == 0:
        return
    opacity = torch.sigmoid(opacities[faint])
    gate = torch.sigmoid(-GATE_SHARPNESS * (opacity - GATE_OPACITY))
    variance = (2 * model.params["scales"][faint]).exp()
    quats = model.params["quats"][faint]
    noise = normal(faint) * (gate * weight)[:, None]
    back = quats * quats.new_tensor([1.0, -1.0, -1.0, -1.0])
    shift = rotate(quats, variance * rotate(back, noise))
    model.params["means"].index_add_(0, faint, shift)


_GONE = -30.0
"""Logit of a dropped splat: far below the opacity at which splats are drawn."""
_MOST = 0.999
"""Highest opacity after compensation; the rasterizer clamps to 0.99 anyway."""


def dropout_blocks(count: int, step: int) -> torch.Tensor:
    """Return the block of each row in dropout, [count] int64 below `count` // `DROPOUT_ROWS` + 2:
    `DROPOUT_ROWS` rows in a row, that begin at another row in each step.

    Neighbours are left out together, because they would take the place of a single splat (DropAnSH,
    arXiv 2602.20933, searches for them; here rows are sorted along a Morton curve anyway).
    """
    first = step % DROPOUT_ROWS
    rows = torch.arange(first, first + count, dtype=torch.int64, device="cpu")
    return rows // DROPOUT_ROWS


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
