"""Adaptive density control of the 3DGS paper: clone, split, prune and reset (Kerbl et al. 2023)."""

import math
from collections.abc import Mapping

import numpy as np
import torch

from ...config import Doubling, TrainConfig
from ...raster.memory import zeros
from ...raster.screen_gradients import add_screen_gradients
from ..model.model import Model
from ..schedule.plan import Plan
from . import row_ops
from .base import Change, DrawnView, Within

RESET_OPACITY = 0.01
"""Ceiling of all opacities at a reset."""


class DefaultStrategy:
    """Clones or splits splats with large screen-space gradients, prunes transparent and huge ones.

    The criterion is |dL / d mean2d| in normalised image coordinates (2 per image side), averaged
    over the views that drew the splat. Under a cap, splats with the largest gradients come first.
    """

    def __init__(self, config: TrainConfig, plan: Plan, *, extent: float, may_grow: Within) -> None:
        self._config = config
        self._plan = plan
        self._extent = extent
        self._may_grow = may_grow

    def start(self, model: Model) -> None:
        model.rows["pull"] = zeros(len(model))
        model.rows["seen"] = zeros(len(model))

    def shape_gradients(self, model: Model) -> None:
        pass

    def observe(self, rows: Mapping[str, torch.Tensor], view: DrawnView) -> None:
        if view.step > self._plan.refine_stop:
            return
        sums, views = rows["pull"], rows["seen"]
        scale, threads = (0.5 * view.width, 0.5 * view.height), self._config.threads
        add_screen_gradients(sums, views, view.v_means2d, view.radii, scale, threads=threads)

    def after_step(
        self, model: Model, *, step: int, means_lr: float, cap: int, generator: torch.Generator
    ) -> Change:
        change = Change()
        if self._plan.refines_at(step):
            change = self._refine(model, step, cap, generator)
        if self._plan.resets_at(step):
            row_ops.reset_opacities(model, RESET_OPACITY)
            change = Change(added=change.added, removed=change.removed, reset=True)
        return change

    def _refine(self, model: Model, step: int, cap: int, generator: torch.Generator) -> Change:
        before = len(model)
        gradients = model.rows["pull"] / model.rows["seen"].clamp_min(1)
        pruned = self._to_prune(model.params, step)
        grow = gradients >= self._plan.grow_grad
        grow &= ~pruned & self._may_grow(model.params["means"])
        room = cap - before + int(pruned.sum())
        grow = _strongest(grow, gradients, max(room, 0))
        new, replaced = self._doubled(model, grow, generator)
        healthy = (~self._to_prune(new, step)).nonzero().flatten()
        new = {name: rows[healthy] for name, rows in new.items()}

        keep = ~pruned
        keep[replaced] = False
        kept = keep.nonzero().flatten()
        kept = kept[row_ops.by_place(model.params["means"][kept])]
        if len(kept) + len(healthy) == 0:  # an empty model cannot recover
            return Change()
        row_ops.edit(model, keep=kept, append=new)
        self.start(model)
        return Change(added=len(healthy), removed=before - len(kept))

    def _doubled(
        self, model: Model, grow: torch.Tensor, generator: torch.Generator
    ) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
        """Return the new splats for the rows `grow`, [N] bool, and the rows, [M], they replace."""
        if self._config.doubling is Doubling.LONG_AXIS:
            rows = grow.nonzero().flatten()
            return row_ops.halve(model, rows), rows
        size = model.params["scales"].amax(dim=1)  # log
        large = size > _log(self._config.grow_scale * self._extent)
        clone, divide = (grow & ~large).nonzero().flatten(), (grow & large).nonzero().flatten()
        return row_ops.join(
            row_ops.duplicate(model, clone), row_ops.split(model, divide, generator)
        ), divide

    def _to_prune(self, params: dict[str, torch.Tensor], step: int) -> torch.Tensor:
        """Return [N] bool: splats that are too transparent, too large after the first opacity
        reset, or have a zero quaternion."""
        config, opacities = self._config, params["opacities"]
        pruned = ~(opacities >= row_ops.logit(max(config.prune_opacity, 1e-6)))  # NaN too
        if self._plan.reset_every and step > self._plan.reset_every:
            size = params["scales"].amax(dim=1)
            pruned |= size > _log(config.prune_scale * self._extent)
        return pruned | (params["quats"].square().sum(dim=1) < 1e-8)


def _log(value: float) -> float:
    return math.log(value) if value > 0 else -math.inf


def _strongest(mask: torch.Tensor, score: torch.Tensor, count: int) -> torch.Tensor:
    """Return `mask`, [N], with at most `count` entries left: those with the largest score; ties in
    order of the rows."""
    chosen = mask.nonzero().flatten()
    if len(chosen) <= count:
        return mask
    order = np.argsort(-score[chosen].numpy(), kind="stable")[:count]
    out = torch.zeros_like(mask)
    out[chosen[torch.from_numpy(order)]] = True
    return out
