"""Depth loss: rendered inverse depth against depth priors, independent of the capture's scale.

With D the accumulated inverse depth of a pixel (sum of w / z), A its opacity (sum of w), P the
prior, c its confidence and m the median of all aligned P:

    aligned views     weight * mean over all pixels of c (|D - P| + (1 - A) P / 2) / max(P, m)
    other views       weight * depth_pearson * (1 - correlation of D and P, weighted by c)

D alone does not distinguish a wall from haze of opacity 0.4 at 0.4 of its distance, which a
training finds first. The second term does: a known depth means an opaque surface, so missing
opacity is an error too.

The divisor makes the error relative for near surfaces, whose inverse depth is large, and in units
of the median for far ones, so that neither dominate the sum. The mean is over all pixels, so a view
with few known pixels has a small loss.
"""

import math
from dataclasses import replace
from typing import Any

import torch

from ...config import TrainConfig
from ...errors import GsError
from ...raster.no_double_backward import no_double_backward
from .targets import DepthTarget, DepthTargets

_SPREAD_FLOOR = 1e-4
"""Variance of inverse depth, in medians squared, added in the correlation: flat maps count less."""
_OPAQUE = 0.5
"""Weight of missing opacity relative to wrong inverse depth."""
_FEW = 6
"""Views of a point up to which depth maps have full weight."""


def with_weights(config: TrainConfig, views: float) -> TrainConfig:
    """Return the options with the automatic weights of the depth loss filled in.

    More views constrain the geometry better, while the errors of a map stay, so the weight is 1 for
    few views and falls with more.

    Args:
        config: The options; a negative weight is automatic.
        views: Median number of training views of a point (`rule.Coverage`).
    """
    first, last = config.depth_weight, config.depth_weight_final
    if first < 0:
        first = min(1.0, _FEW / views) if views else 1.0
    return replace(config, depth_weight=first, depth_weight_final=first if last < 0 else last)


def weight_at(config: TrainConfig, step: int) -> float:
    """Weight of the depth loss at `step`: log-linear from first to last, faded in at the start."""
    first, last = config.depth_weight, config.depth_weight_final
    done = min(step / config.iterations, 1.0)
    if first > 0 and last > 0:
        weight = math.exp((1 - done) * math.log(first) + done * math.log(last))
    else:
        weight = (1 - done) * first + done * last
    warmup = config.depth_warmup * config.iterations
    return weight * min(step / warmup, 1.0) if warmup > 0 else weight


class GuideLoss:
    """Depth loss of a guide's surface mesh, with a constant weight.

    It acts on both sides of the surface. Without a term for splats in front of the mesh, splats
    close to cameras compensated for missing opacity behind them, and no gradient pulled them back.
    """

    def __init__(self, targets: DepthTargets, *, weight: float, scale: float) -> None:
        """`scale`: training units per world unit."""
        self.targets = targets
        self._weight = weight
        # Lengths grow by the scale, so inverse depths shrink by it.
        self._unit = targets.unit / scale

    def weight(self, index: int, step: int) -> float:
        """Weight of the loss of view `index`; 0: no inverse depth is needed."""
        return self._weight if index in self.targets else 0.0

    def __call__(
        self, index: int, inverse_depth: torch.Tensor, alpha: torch.Tensor
    ) -> torch.Tensor:
        """The loss of view `index`, without its weight.

        Args:
            index: A view with a prior.
            inverse_depth: [H, W] float, rendered, 1/training unit; differentiable.
            alpha: [H, W] float, rendered opacity; differentiable.
        """
        height, width = inverse_depth.shape
        target = self.targets.at(index, width, height)
        if target is None:
            return inverse_depth.new_zeros(())
        if target.aligned:
            return l1_loss(inverse_depth, alpha, target, unit=self._unit)
        return pearson_loss(inverse_depth / self._unit, target)


class DepthLoss(GuideLoss):
    """The depth loss of a run, with the weights of its options."""

    def __init__(self, config: TrainConfig, targets: DepthTargets, *, scale: float) -> None:
        """`scale`: training units per world unit."""
        super().__init__(targets, weight=1.0, scale=scale)
        self._config = with_weights(config, targets.views)

    def set_length(self, iterations: int) -> None:
        """Fit the schedule of the weight to a run of this many steps."""
        self._config = replace(self._config, iterations=iterations)

    def weight(self, index: int, step: int) -> float:
        """Weight of the loss of view `index`; 0: no inverse depth is needed."""
        if index not in self.targets:
            return 0.0
        weight = weight_at(self._config, step)
        return weight if self.targets.is_aligned(index) else weight * self._config.depth_pearson


def l1_loss(
    inverse_depth: torch.Tensor, alpha: torch.Tensor, target: DepthTarget, *, unit: float
) -> torch.Tensor:
    """Mean over all pixels of c (|D / unit - P| + (1 - A) P / 2) / max(P, 1), with P in units.

    Args:
        inverse_depth: D, [H, W] float, 1/training unit; differentiable.
        alpha: A, [H, W] float, opacity; differentiable.
        target: P and c, [H, W].
        unit: 1/training unit.
    """
    return _L1.apply(inverse_depth, alpha, target, 1.0 / unit)  # pyright: ignore[reportReturnType]


class _L1(torch.autograd.Function):
    """Fused operation: a few passes over the image instead of one per torch operation."""

    @staticmethod
    def forward(  # pyright: ignore[reportIncompatibleMethodOverride]
        ctx: Any, image: torch.Tensor, alpha: torch.Tensor, target: DepthTarget, scale: float
    ) -> torch.Tensor:
        prior = target.inverse_depth.to(image.dtype)
        weight = target.confidence.to(image.dtype)
        weight.mul_(1 / (255 * image.numel())).div_(prior.clamp_min(1.0))
        error = image.mul(scale).sub_(prior)
        loss = torch.dot(weight.flatten(), error.abs().flatten())
        inverse_depth = error.sign_().mul_(weight).mul_(scale)
        hollow = weight.mul_(prior).mul_(_OPAQUE)
        loss += hollow.sum() - torch.dot(hollow.flatten(), alpha.flatten())
        ctx.gradients = [inverse_depth, hollow.neg_()]
        ctx.save_for_backward(image, alpha)
        return loss

    @staticmethod
    def backward(ctx: Any, v_loss: torch.Tensor) -> tuple[torch.Tensor | None, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        # In place and therefore only once: allocating an image costs as much as three passes.
        if not ctx.gradients:
            raise GsError("Gradients of l1_loss can be taken only once: leave out retain_graph.")
        v_alpha, v_inverse_depth = ctx.gradients.pop(), ctx.gradients.pop()
        found = [v_inverse_depth.mul_(v_loss), v_alpha.mul_(v_loss)]
        return *no_double_backward("l1_loss", found, [*ctx.saved_tensors, v_loss]), None, None


def pearson_loss(inverse_depth: torch.Tensor, target: DepthTarget) -> torch.Tensor:
    """1 - weighted correlation with the prior; invariant to a scale > 0 and offset of the prior.

    Args:
        inverse_depth: [H, W] float in medians of the capture; differentiable.
        target: The prior, [H, W].
    """
    weight = target.confidence.to(inverse_depth.dtype).flatten()
    weight = weight / weight.sum().clamp_min(1.0)
    x, y = inverse_depth.flatten(), target.inverse_depth.to(inverse_depth.dtype).flatten()
    x, y = x - torch.dot(weight, x), y - torch.dot(weight, y)
    xx, yy = torch.dot(weight, x * x), torch.dot(weight, y * y)
    xy = torch.dot(weight, x * y)
    return 1 - xy / ((xx + _SPREAD_FLOOR) * (yy + _SPREAD_FLOOR)).sqrt()
