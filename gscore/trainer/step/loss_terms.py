"""Loss terms of a step: kinds and weights, and the term of depth maps and guide meshes."""

from functools import partial

import numpy as np
import torch

from ...config import TrainConfig
from ...engine.base import PictureTerm, TermGradients, TermKind
from ..depth.loss import DepthLoss, GuideLoss
from ..depth.targets import DepthTargets


class LossTerms:
    """Terms of the loss of rendered views against photos, depth maps, guide meshes and masks."""

    def __init__(
        self,
        config: TrainConfig,
        *,
        mask_mode: str,
        depth: DepthTargets | None,
        surface: DepthTargets | None,
        scale: float,
    ) -> None:
        """Create the terms.

        Args:
            config: The options.
            mask_mode: Use of the masks, as `Dataset.mask_mode`.
            depth: Targets of depth maps; None: none.
            surface: Targets of a guide mesh; None: none.
            scale: Training units per world unit.
        """
        ssim, composite = config.ssim_weight, mask_mode == "composite"
        weights = {
            TermKind.L1: 1 - ssim,
            TermKind.SSIM: ssim,
            TermKind.MASK_ALPHA: config.alpha_weight if composite else 0.0,
            TermKind.SEE_THROUGH: 0.0 if composite else config.opaque_weight,
        }
        self.terms = tuple(weights.items())
        """Kinds and weights."""
        self.depth = None if depth is None else DepthLoss(config, depth, scale=scale)
        """The depth loss; None: no depth supervision."""
        self._guide = None
        if surface is not None:
            self._guide = GuideLoss(surface, weight=config.guide_weight, scale=scale)

    @property
    def needs_pictures(self) -> bool:
        """True if any view has a loss of inverse depth."""
        return self.depth is not None or self._guide is not None

    def picture_term(self, index: int, step: int) -> PictureTerm | None:
        """Return the inverse-depth losses of view `index` at `step`, summed; None: there are
        none."""
        losses = [loss for loss in (self.depth, self._guide) if loss is not None]
        terms = [(w, loss) for loss in losses if (w := loss.weight(index, step)) > 0]
        return partial(_sum_of, terms, index) if terms else None


def _sum_of(
    terms: list[tuple[float, GuideLoss]],
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
