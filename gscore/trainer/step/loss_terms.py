"""Loss terms of a step: kinds and weights, and the term of depth maps and guide meshes."""

from functools import partial

import numpy as np
import torch

from ...config import TrainConfig
from ...engine.base import PictureTerm, TermGradients, TermKind
from ..depth.loss import DepthLoss
from ..guide.loss import GuideLoss


class LossTerms:
    """Terms of the loss of rendered views against photos, depth maps, guide meshes and masks."""

    def __init__(
        self,
        config: TrainConfig,
        *,
        mask_mode: str,
        depth: DepthLoss | None,
        guide: GuideLoss | None,
    ) -> None:
        """`depth` and `guide`: losses of inverse depth by depth maps and guide meshes; None: not
        used."""
        ssim, composite = config.ssim_weight, mask_mode == "composite"
        weights = {
            TermKind.L1: 1 - ssim,
            TermKind.SSIM: ssim,
            TermKind.MASK_ALPHA: config.alpha_weight if composite else 0.0,
            TermKind.SEE_THROUGH: 0.0 if composite else config.opaque_weight,
        }
        self.terms = tuple(weights.items())
        """Kinds and weights."""
        self._depth = depth
        self._guide = guide

    def picture_term(self, index: int, step: int) -> PictureTerm | None:
        """Return the inverse-depth losses of view `index` at `step`, summed; None: there are
        none."""
        terms: list[tuple[float, DepthLoss | GuideLoss]] = []
        if self._depth:
            terms.append((self._depth.weight(index, step), self._depth))
        if self._guide:
            terms.append((self._guide.weight(index), self._guide))
        terms = [(weight, loss) for weight, loss in terms if weight > 0]
        return partial(_sum_of, terms, index) if terms else None


def _sum_of(
    terms: list[tuple[float, DepthLoss | GuideLoss]],
    index: int,
    inverse_depth: np.ndarray,
    alpha: np.ndarray,
) -> TermGradients:
    """Compute the weighted sum of losses of view `index`, with its gradients."""
    leaves = [torch.from_numpy(a).requires_grad_() for a in (inverse_depth, alpha)]
    parts = [weight * loss(index, *leaves) for weight, loss in terms]
    term = sum(parts[1:], start=parts[0])
    if not term.requires_grad:
        return TermGradients(term.item(), None, None)
    v_inverse_depth, v_alpha = (
        None if v is None else v.numpy()
        for v in torch.autograd.grad(term, leaves, allow_unused=True)
    )
    return TermGradients(term.item(), v_inverse_depth, v_alpha)
