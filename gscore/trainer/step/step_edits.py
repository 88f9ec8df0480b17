"""Step edits: the changes of rows after a step, by strategy, pruning, region and sanitizing."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch

from ...config import TrainConfig
from ...engine.base import Contribution, Engine, EngineModel, RowEdit
from ...raster.memory import empty, ones, zeros
from ...raster.request import Frustum
from ..model.ensemble_member import EnsembleMember
from ..region.region_photos import RegionBox
from ..schedule.plan import Plan
from ..strategy import Change, Policy
from ..strategy.base import Read
from ..strategy.pruning import Pruner
from ..views.model_renderer import ModelRenderer
from .step_queue import engine_errors
from .step_result import StepResult
from .training_views import ViewBatcher

_MARGIN = 0.15
"""Margin around a photo, relative to its sides, from which splats may still reach into it."""


def sampling_rates(means: torch.Tensor, views: Iterable[Frustum]) -> torch.Tensor:
    """Return sampling rates of positions: pixels per unit in the nearest photo that has them in its
    frame, occluded or not (Yu et al. 2024, Mip-Splatting, section 4.2).

    Args:
        means: [N, 3] float32, any unit.
        views: Perspective views.

    Returns:
        [N] float32; 0 where no photo contains the position.
    """
    rates = zeros(len(means))
    if not len(means):
        return rates
    places = torch.cat([means.T, ones(1, len(means))])
    found = empty(3, len(means))
    for view in views:
        viewmat, K = (torch.from_numpy(np.asarray(m, np.float32)) for m in (view.viewmat, view.K))
        x, y, z = torch.mm(K @ viewmat[:3], places, out=found)
        inside = z > view.near
        for at, side in ((x, view.width), (y, view.height)):
            inside &= (at > -_MARGIN * side * z) & (at < (1 + _MARGIN) * side * z)
        rate = float(max(K[0, 0], K[1, 1])) / z
        torch.maximum(rates, rate.where(inside, rates), out=rates)
    return rates


def min_scale_edit(read: Read, views: Iterable[Frustum], pixels: float) -> RowEdit:
    """Return the edit that raises scales to at least `pixels` of the nearest photo: the 3D filter
    of Mip-Splatting (Yu et al. 2024).

    The photos do not constrain a splat thinner than a pixel of every photo, because the rasterizer
    widens it to half a pixel; a closer view would show the arbitrary thickness.

    Args:
        read: Returns columns.
        views: Training views at full photo size.
        pixels: Standard deviation, above 0.
    """
    rates = sampling_rates(torch.from_numpy(read("means")), views)
    floor = math.log(pixels) - torch.log(rates)
    # Without a photo there is no limit; log 0 would make it infinite.
    floor.masked_fill_(rates == 0, -math.inf)
    scales = torch.maximum(torch.from_numpy(read("scales")), floor[:, None])
    return RowEdit(values={"scales": scales.numpy()})


SANITIZE_EVERY = 100
"""Steps between two sanitizing passes, see `engine.cpu.sanitize`."""


@dataclass(eq=False)
class StepEdits:
    """Edits of models after a step, each decided from the columns that the one before left."""

    config: TrainConfig
    """The options."""
    engine: Engine[Any]
    """Owns the models."""
    pruner: Pruner
    """Prunes in addition to the strategy."""
    renderer: ModelRenderer
    """Has the views for minimum scales."""
    view_batcher: ViewBatcher
    """Has the views for contributions."""
    generator: torch.Generator
    """Source of the strategy's random numbers."""
    region: RegionBox | None
    """Box that splats may not leave, training frame; None: no limit."""
    extent: float
    """Camera extent, training units."""

    def due_at(self, plan: Plan, step: int, members: Iterable[EnsembleMember]) -> bool:
        """Return whether anything may change after `step`."""
        return (
            self.region is not None
            or step % SANITIZE_EVERY == 0
            or plan.refines_at(step)
            or plan.resets_at(step)
            or plan.prunes_free_space_at(step)  # masked splats too
            or any(plan.surplus_at(step, len(one.model), one.pruned) for one in members)
        )

    def apply(
        self,
        result: StepResult,
        members: Iterable[EnsembleMember],
        plan: Plan,
        strategy: Policy,
        *,
        frozen: int,
    ) -> StepResult:
        """Densify, prune and sanitize models after a step.

        Args:
            result: Result of the step.
            members: Models that took it.
            plan: Plan of the run.
            strategy: Strategy of the run.
            frozen: Number of frozen splats, which count to the cap.

        Returns:
            The result with the changes and the number of rows that were reset.
        """
        step = result.step
        cap = plan.cap_for(self.view_batcher.factor) - frozen
        for member in members:
            with engine_errors(self.engine, f"after step {step}"):
                change, lost_rows = self._edit(member, plan, strategy, step, cap)
            lost_rows += result.lost_rows
            result = result._replace(change=result.change + change, lost_rows=lost_rows)
        return result

    def _edit(
        self, member: EnsembleMember, plan: Plan, strategy: Policy, step: int, cap: int
    ) -> tuple[Change, int]:
        """Change a model; returns the change, and the number of runaway rows that were reset."""
        model, pruner = member.model, self.pruner
        weights = partial(self._contributions, model)
        if plan.refines_at(step):
            self.engine.release()
        change = self._apply(model, pruner.prune_free_space(model.column, plan, step))
        change += self._apply(model, pruner.prune_masked(len(model), weights, plan, step))
        refined = strategy.refine(model.column, step=step, cap=cap, generator=self.generator)
        change += self._apply(model, refined)
        if self.region is not None:
            inside = self.region.keep_inside(model.column("means"))
            self._apply(model, () if inside is None else (inside,))
        least = pruner.prune_least(len(model), weights, plan, step, pruned=member.pruned)
        pruned = self._apply(model, least)
        member.pruned += pruned.removed
        lost_rows = model.clamp_runaways(self.extent) if step % SANITIZE_EVERY == 0 else 0
        if self.config.finest > 0 and plan.prunes_free_space_at(step):
            views = map(self.renderer.view, self.view_batcher.indices)
            model.edit(min_scale_edit(model.column, views, self.config.finest))
        return change + pruned, lost_rows

    def _apply(self, model: EngineModel, edits: Iterable[RowEdit]) -> Change:
        """Apply edits, each before the next is decided; returns what they change."""
        change = Change()
        for edit in edits:
            if edit.moves_rows:
                self.engine.release()
            change += Change.of(edit, len(model))
            model.edit(edit)
        return change

    def _contributions(self, model: EngineModel) -> Iterable[Contribution]:
        """Contributions of the splats to all training views, at the size of the last step."""
        views = (
            (sized.view, sized.photo(self.renderer.photos.mask_mode))
            for sized in self.view_batcher.training_views()
        )
        return self.engine.contributions(model, views, antialias=self.config.antialias)
