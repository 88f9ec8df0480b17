"""Step edits: the changes of rows after a step, by strategy, pruning, region and sanitizing."""

from collections.abc import Iterable
from functools import partial
from typing import Any

import torch

from ...config import TrainConfig
from ...engine.base import Contribution, Engine, EngineModel, RowEdit
from ..model.ensemble_member import EnsembleMember
from ..region.region_box import RegionBox
from ..schedule.plan import Plan
from ..strategy import Change, Policy
from ..strategy.min_scale import min_scale_edit
from ..strategy.pruning import Pruner
from ..views.model_renderer import ModelRenderer
from .step_queue import engine_errors
from .step_result import StepResult
from .training_views import ViewBatcher

SANITIZE_EVERY = 100
"""Steps between two sanitizing passes, see `engine.cpu.sanitize`."""


class StepEdits:
    """Edits of models after a step, each decided from the columns that the one before left."""

    def __init__(
        self,
        config: TrainConfig,
        engine: Engine[Any],
        pruner: Pruner,
        renderer: ModelRenderer,
        view_batcher: ViewBatcher,
        generator: torch.Generator,
        *,
        region: RegionBox | None,
        extent: float,
    ) -> None:
        """Create the edits of a training.

        Args:
            config: The options.
            engine: Owns the models.
            pruner: Prunes in addition to the strategy.
            renderer: Has the views for minimum scales.
            view_batcher: Has the views for contributions.
            generator: Source of the strategy's random numbers.
            region: Box that splats may not leave, training frame; None: no limit.
            extent: Camera extent, training units.
        """
        self._config = config
        self._engine = engine
        self._pruner = pruner
        self._renderer = renderer
        self._view_batcher = view_batcher
        self._generator = generator
        self._region = region
        self._extent = extent

    def due_at(self, plan: Plan, step: int, members: Iterable[EnsembleMember]) -> bool:
        """Return whether anything may change after `step`."""
        return (
            self._region is not None
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
            The result with the changes, and the numbers of rows that were reset or cleared.
        """
        cleared, step = self._pruner.guided.count, result.step
        cap = plan.cap_for(self._view_batcher.factor) - frozen
        for member in members:
            with engine_errors(self._engine, f"after step {step}"):
                change, lost_rows = self._edit(member, plan, strategy, step, cap)
            lost_rows += result.lost_rows
            result = result._replace(change=result.change + change, lost_rows=lost_rows)
        return result._replace(cleared_rows=self._pruner.guided.count - cleared)

    def _edit(
        self, member: EnsembleMember, plan: Plan, strategy: Policy, step: int, cap: int
    ) -> tuple[Change, int]:
        """Change a model; returns the change, and the number of runaway rows that were reset."""
        model, pruner = member.model, self._pruner
        weights = partial(self._contributions, model)
        if plan.refines_at(step):
            self._engine.release()
        change = self._apply(model, pruner.prune_free_space(model.column, plan, step))
        change += self._apply(model, pruner.prune_masked(len(model), weights, plan, step))
        refined = strategy.refine(model.column, step=step, cap=cap, generator=self._generator)
        change += self._apply(model, refined)
        if self._region is not None:
            inside = self._region.keep_inside(model.column("means"))
            self._apply(model, () if inside is None else (inside,))
        least = pruner.prune_least(len(model), weights, plan, step, pruned=member.pruned)
        pruned = self._apply(model, least)
        member.pruned += pruned.removed
        lost_rows = model.clamp_runaways(self._extent) if step % SANITIZE_EVERY == 0 else 0
        if self._config.finest > 0 and plan.prunes_free_space_at(step):
            views = map(self._renderer.view, self._view_batcher.indices)
            model.edit(min_scale_edit(model.column, views, self._config.finest))
        return change + pruned, lost_rows

    def _apply(self, model: EngineModel, edits: Iterable[RowEdit]) -> Change:
        """Apply edits, each before the next is decided; returns what they change."""
        change = Change()
        for edit in edits:
            if edit.moves_rows:
                self._engine.release()
            change += Change.of(edit, len(model))
            model.edit(edit)
        return change

    def _contributions(self, model: EngineModel) -> Iterable[Contribution]:
        """Contributions of the splats to all training views, at the size of the last step."""
        views = (
            (sized.view, sized.photo(self._view_batcher.mask_mode))
            for sized in self._view_batcher.training_views()
        )
        return self._engine.contributions(model, views, antialias=self._config.antialias)
