"""Step loss: the photometric loss of a view, with depth, mask and guide terms."""

from typing import NamedTuple

import torch

from ...config import TrainConfig
from ...raster.loss import image_loss_gradient
from ...raster.memory import empty
from ...raster.training_rasterizer import Picture
from ..depth.loss import DepthLoss
from ..depth.regularisers import mean_transmittance, opacity_loss
from ..guide.loss import GuideLoss
from ..views.model_renderer import mse_of_unmasked
from .training_views import TrainingView


class LossAndGradients(NamedTuple):
    """Loss of this rank's view, and its gradients in the rendered image."""

    value: float
    """Total loss."""
    mse: float
    """Mean squared error of the unmasked pixels."""
    v_rgb: torch.Tensor
    """[H, W, 3] float32; valid until the next call."""
    v_log_gain: tuple[float, float, float]
    """Derivatives in ln gain of R, G, B."""
    v_alpha: torch.Tensor | None
    """[H, W] float32; None: the loss does not depend on it."""
    v_inverse_depth: torch.Tensor | None
    """[H, W] float32; None: the loss does not depend on it."""


class StepLoss:
    """Loss of rendered views against photos, depth maps, guide meshes and masks."""

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
        self._config = config
        self._mask_mode = mask_mode
        self._depth = depth
        self._guide = guide
        self._v_rgb = empty(0)

    def uses_depth(self, training_view: TrainingView, step: int) -> bool:
        """Return whether the loss of a view at `step` needs its inverse depth."""
        return bool(self._depth_terms(training_view.index, step))

    def of(self, picture: Picture, training_view: TrainingView, step: int) -> LossAndGradients:
        """Compute the loss of a rendered view at `step`."""
        _, image, mask, _, counted = training_view.sized
        if self._v_rgb.shape != picture.rgb.shape:
            self._v_rgb = empty(*picture.rgb.shape)
        found = image_loss_gradient(
            picture.rgb,
            torch.from_numpy(image),
            self._v_rgb,
            ssim_weight=self._config.ssim_weight,
            mask=None if mask is None else torch.from_numpy(mask),
            mask_mode="none" if mask is None else self._mask_mode,
            background=training_view.background,
            threads=self._config.threads,
            gain=training_view.gain,
        )
        more, v_alpha, v_inverse_depth = self._further_terms(picture, training_view, step)
        return LossAndGradients(
            value=found.loss + more,
            mse=mse_of_unmasked(found.mse, counted),
            v_rgb=self._v_rgb,
            v_log_gain=found.v_log_gain,
            v_alpha=v_alpha,
            v_inverse_depth=v_inverse_depth,
        )

    def _depth_terms(self, index: int, step: int) -> list[tuple[float, DepthLoss | GuideLoss]]:
        """Inverse-depth losses of view `index` at `step`, with their weights above 0."""
        found: list[tuple[float, DepthLoss | GuideLoss]] = []
        if self._depth:
            found.append((self._depth.weight(index, step), self._depth))
        if self._guide:
            found.append((self._guide.weight(index), self._guide))
        return [(weight, loss) for weight, loss in found if weight > 0]

    def _further_terms(
        self, picture: Picture, training_view: TrainingView, step: int
    ) -> tuple[float, torch.Tensor | None, torch.Tensor | None]:
        """Compute the depth, guide, mask and opacity terms of a view's loss, with their gradients
        in opacity and inverse depth; None: no dependence."""
        config, mask, composite = (
            self._config,
            training_view.sized.mask,
            self._mask_mode == "composite",
        )
        value, v_alpha, v_inverse_depth = 0.0, None, None
        if picture.inverse_depth is not None:  # only rendered if `uses_depth`
            terms = self._depth_terms(training_view.index, step)
            inverse_depth = picture.inverse_depth.detach().requires_grad_()
            alpha = picture.alpha.detach().requires_grad_()
            parts = [
                weight * loss(training_view.index, inverse_depth, alpha) for weight, loss in terms
            ]
            term = sum(parts[1:], start=parts[0])
            value += term.item()
            v_inverse_depth, v_alpha = _gradients(term, inverse_depth, alpha)
        if config.alpha_weight and mask is not None and composite:
            alpha = picture.alpha.detach().requires_grad_()
            term = config.alpha_weight * opacity_loss(alpha, torch.from_numpy(mask))
            value += term.item()
            (more,) = _gradients(term, alpha)
            v_alpha = more if v_alpha is None or more is None else v_alpha + more
        if config.opaque_weight and not composite:
            through, slope = mean_transmittance(picture.alpha.detach(), mask)
            value += config.opaque_weight * through
            slope *= config.opaque_weight
            v_alpha = slope if v_alpha is None else v_alpha + slope
        return value, v_alpha, v_inverse_depth


def _gradients(term: torch.Tensor, *leaves: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
    """Return d term / d leaf; None if the term does not depend on a leaf."""
    if not term.requires_grad:
        return (None,) * len(leaves)
    return torch.autograd.grad(term, leaves, allow_unused=True)
