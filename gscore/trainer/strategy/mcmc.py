"""MCMC strategy: relocation, slow growth to a cap, and noise (Kheradmand et al. 2024)."""

from collections.abc import Mapping

import torch

from ...config import TrainConfig
from ..host.random import gaussian
from ..model.model import Model
from ..schedule.plan import Plan
from . import row_ops
from .base import Change, DrawnView, Within

GATE_SHARPNESS = 100.0
GATE_OPACITY = 0.005
"""Opacity around which noise fades out: sigmoid(-sharpness (opacity - GATE_OPACITY))."""
NOISE_MAX_OPACITY = 0.1
"""Opacity from which splats get no noise; the gate would leave less than 1e-4 of it."""


class MCMCStrategy:
    """Grows the model on a fixed schedule, relocates dead splats and adds noise to faint ones."""

    def __init__(self, config: TrainConfig, plan: Plan, *, extent: float, may_grow: Within) -> None:
        self._config = config
        self._plan = plan
        self._extent = extent
        self._may_grow = may_grow

    def start(self, model: Model) -> None:
        pass

    def shape_gradients(self, model: Model) -> None:
        """Add the gradients of opacity_reg * mean(opacity) + scale_reg * mean(scale)."""
        if len(model) == 0:
            return
        scales, grads = model.params["scales"], model.grads
        if self._config.opacity_reg:
            opacity = torch.sigmoid(model.params["opacities"])
            slope = opacity * (1 - opacity)
            grads["opacities"].add_(slope, alpha=self._config.opacity_reg / len(model))
        if self._config.scale_reg:
            weight = self._config.scale_reg / scales.numel()
            grads["scales"].add_(scales.exp(), alpha=weight)

    def observe(self, rows: Mapping[str, torch.Tensor], view: DrawnView) -> None:
        pass

    def after_step(
        self, model: Model, *, step: int, means_lr: float, cap: int, generator: torch.Generator
    ) -> Change:
        change = Change()
        if self._plan.refines_at(step):
            change = self._refine(model, cap, generator)
        self._add_noise(model, means_lr, generator)
        return change

    def _refine(self, model: Model, cap: int, generator: torch.Generator) -> Change:
        floor = max(self._config.prune_opacity, 1e-6)
        opacities = model.params["opacities"]
        dead = ~(opacities > row_ops.logit(floor))  # NaN is dead too
        dead |= model.params["quats"].square().sum(dim=1) < 1e-8
        within = self._may_grow(model.params["means"])
        moved = row_ops.relocate(model, dead, generator, within=within, min_opacity=floor)
        target = min(cap, int((1 + self._plan.mcmc_growth) * len(model)))
        within = self._may_grow(model.params["means"])
        added = row_ops.grow(
            model, target - len(model), generator, within=within, min_opacity=floor
        )
        return Change(added=added, moved=moved)

    def _add_noise(self, model: Model, means_lr: float, generator: torch.Generator) -> None:
        """Move faint splats by covariance @ normal noise."""
        weight = self._config.mcmc_noise * means_lr
        opacities = model.params["opacities"]
        faint = (opacities < row_ops.logit(NOISE_MAX_OPACITY)).nonzero().flatten()
        if weight <= 0 or len(faint) == 0:
            return
        opacity = torch.sigmoid(opacities[faint])
        gate = torch.sigmoid(-GATE_SHARPNESS * (opacity - GATE_OPACITY))
        variance = (2 * model.params["scales"][faint]).exp()
        quats = model.params["quats"][faint]
        noise = gaussian((len(faint), 3), generator) * (gate * weight)[:, None]
        back = quats * quats.new_tensor([1.0, -1.0, -1.0, -1.0])
        shift = row_ops.rotate(quats, variance * row_ops.rotate(back, noise))
        model.params["means"].index_add_(0, faint, shift)
