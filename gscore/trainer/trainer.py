"""Trainer: the training step and all state it depends on; no files, events or clock."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import torch

from ..config import Skip, TrainConfig
from ..engine.base import (
    Columns,
    Contribution,
    Engine,
    EngineModel,
    RowEdit,
    ShUpdate,
    StepRequest,
)
from ..engine.cpu.engine import CpuEngine
from ..engine.cpu.ensemble import divide_opacities
from ..engine.random import generator_of
from ..engine.stage_timer import StageTimer
from ..errors import DatasetError, GsError
from ..events import Decision
from ..formats.joined import joined
from ..splats import PARAMETERS, Splats
from ..text_format import count_words, number
from .analysis.analysis import Analysis
from .depth.loss import DepthLoss
from .depth.regularisers import drop_rate_at, drop_rate_of
from .distributed.process_group import ProcessGroup
from .guide.loss import GuideLoss
from .guide.mesh_free_space import MeshFreeSpace
from .model.checkpoint_schema import as_float, as_int
from .model.ensemble_member import EnsembleMember, count_members
from .model.training_frame import TrainingFrame
from .photos.raster_skips import disabled_skips
from .photos.view_sampler import ViewSampler
from .region.frozen_splats import FrozenSplats, split_frozen
from .schedule.caps import max_splats_per_model, model_count
from .schedule.plan import Plan
from .step.loss_terms import LossTerms
from .step.step_result import StepResult, combine_results
from .step.training_views import TrainingView, ViewBatcher
from .strategy import Change, all_within, make_strategy
from .strategy.initialization import initial_splats
from .strategy.pruning import Pruner
from .views.held_out_gains import HeldOutGains
from .views.model_renderer import ModelRenderer
from .views.photo_gains import as_color
from .views.photo_parameters import PhotoParameters, initial_poses

_IN_CELL = (
    "Splats are added only in the block's cell: the start splats cover its surroundings, which "
    "`gscore merge` leaves out."
)
_MAX_SKIPPED = 100
SANITIZE_EVERY = 100
"""Steps between two sanitizing passes, see `engine.cpu.sanitize`."""
_ROWS_A_PART = 1 << 16
"""Splats per part of `parts`."""


class Trainer:
    """Splats in training. The same inputs give the same bits, for any number of threads.

    All randomness comes from one generator; everything that is summed over splats or pixels is
    summed in a fixed order. Run it with `torch.set_num_threads(1)`, see `session`.
    """

    team: ProcessGroup | None = None
    """Process group of a distributed training; None: one process."""

    def __init__(
        self, config: TrainConfig, analysis: Analysis, engine: Engine[Any] | None = None
    ) -> None:
        """Start from the splats or points of `analysis`.

        Args:
            config: Training options.
            analysis: The capture and what was found out about it.
            engine: Computes the steps; None: the CPU.

        Raises:
            DatasetError: no training photos.
            ConfigError: more start splats than the config allows, or none in the region.
        """
        photos, start, guide = analysis.photos, analysis.start, analysis.guide
        if not photos.train:
            raise DatasetError(
                "The capture has no training photos, because all views are held out for the test; "
                "hold out fewer."
            )
        self.config = config
        self.photos = photos
        self._given = start is not None
        self._decide_by_photos(analysis.known)
        self.frame = analysis.frame or TrainingFrame.of(photos.scene, near=config.near)
        cloud = photos.scene.points if analysis.points is None else analysis.points
        most = max_splats_per_model(config, self._models)
        count = min(len(cloud), most) if start is None else len(start)
        given = photos.scene.cameras
        self._plan_of = partial(
            Plan.of,
            extent=self.frame.extent,
            points=count,
            side=int(min(given.widths.min(), given.heights.min())),
            pixels=int((given.widths * given.heights)[list(photos.train)].mean()),
            subject=photos.mask_mode == "composite",
        )
        self.depth: DepthLoss | None = None
        """The depth loss; None: no depth supervision."""
        if analysis.depth is not None:
            self.depth = DepthLoss(config, analysis.depth, scale=self.frame.similarity.scale)
        self.guide: GuideLoss | None = None
        """The loss of the surface mesh; None: no surface mesh."""
        if guide.surface is not None:
            self.guide = GuideLoss(
                guide.surface, weight=config.guide_weight, scale=self.frame.similarity.scale
            )
        self.guide_digest = guide.digest
        """Hash of the guide meshes; empty: none."""
        self._block = analysis.block
        self.replan(config.iterations)
        self.generator = generator_of(config.seed)
        self.sampler = ViewSampler(photos.train)
        self.steps = 0
        """Steps taken."""
        self.bad_rows = 0
        """Gradient rows skipped so far because they were not finite."""
        self.lost_rows = 0
        """Runaway splats reset so far, see `engine.cpu.sanitize`."""
        self.rate_factor = 1.0
        """Factor of all learning rates."""
        self._skipped = 0
        self.stage_timer = StageTimer()
        """Seconds of the stages of the last step."""
        cameras = self.frame.similarity.cameras_to_training(photos.scene.cameras)
        self.photo_parameters = PhotoParameters(
            config,
            analysis.gains,
            initial_poses(analysis.pose_check, photos.train, self.frame),
            HeldOutGains(
                photos.scene.cameras.names,
                photos.scene.cameras.centers,
                photos.train,
                stops=analysis.facts.stops,
            ),
        )
        """Optimised exposure gains and camera poses of the photos."""
        region = analysis.region
        self.region = None if region is None else region.in_training(self.frame.similarity)
        """The region box, training frame; its start splats are kept inside."""
        self.frozen: FrozenSplats | None = None
        """Frozen splats around the region, rendered with the trained ones; None: none."""
        if region is not None and start is not None:
            start, self.frozen = split_frozen(start, region, config, self.frame)
        first, free_space = initial_splats(
            config, photos, self.frame, self.plan, cameras, cloud, start=start, count=count
        )
        self.engine = self._make_engine() if engine is None else engine
        """Computes the steps."""
        self.members = self._members_of(first)
        """Models that are trained in parallel; one with start splats."""
        self.renderer = ModelRenderer(
            config,
            photos,
            self.frame,
            cameras,
            self.photo_parameters,
            self.engine,
            self._all_models,
            cache=analysis.photo_cache,
            region=self.frozen is not None,
        )
        """Renderer of the current model."""
        self._view_batcher = ViewBatcher(
            config,
            self.sampler,
            self.renderer,
            self.photo_parameters,
            self.generator,
            mask_mode=photos.mask_mode,
            team=self.team,
        )
        self._terms = LossTerms(
            config, mask_mode=photos.mask_mode, depth=self.depth, guide=self.guide
        )
        self.pruner = Pruner(
            config,
            free_space,
            masks_hide=photos.mask_mode == "ignore",
            guided=MeshFreeSpace(guide.free, given, self.frame.similarity) if guide.free else None,
        )
        """Pruning in addition to that of the strategy."""
        self._disable = disabled_skips(config.without)
        self._given_degree = first.sh_degree
        self.cut_degree = max(0 if start is None else start.sh_degree, first.sh_degree)
        """SH degree of the start splats before it was cut to that of the config."""
        if Skip.SH_BANDS in config.without:
            for member in self.members:
                member.model.widen_sh(config.sh_degree)

    @property
    def model(self) -> EngineModel:
        """The first model: splats with their moments and counters."""
        return self.members[0].model

    @property
    def splat_count(self) -> int:
        """Number of splats, frozen ones included."""
        return self.trained_count + self._frozen_count

    @property
    def trained_count(self) -> int:
        """Number of trained splats."""
        return sum(len(member.model) for member in self.members)

    @property
    def _frozen_count(self) -> int:
        return 0 if self.frozen is None else len(self.frozen)

    @property
    def decisions(self) -> list[Decision]:
        """Decisions on the region, or the cell in which splats are added, and by the photos on
        dropout and ensemble."""
        return [one for one in (self._region_decision(), *self._by_photos) if one is not None]

    def _region_decision(self) -> Decision | None:
        if self.region is None:
            return Decision("region", _IN_CELL) if self._block else None
        if not self._given:
            return Decision("region", "Only pixels that show the region are trained.")
        count, frozen = count_words(self.trained_count, "splat"), number(self._frozen_count)
        return Decision("region", f"{count} in the region; {frozen} around it are frozen.")

    def plan_of(self, iterations: int) -> Plan:
        """Return the plan of a run with `iterations` steps; cheap."""
        config = replace(self.config, iterations=iterations)
        return self._plan_of(config, drops=self.drop_rate > 0, models=self._models)

    def replan(self, iterations: int) -> None:
        """Change the length of the run: from the next step on, schedules are those of `iterations`
        steps."""
        self.plan = self.plan_of(iterations)
        """Schedules of the run."""
        self.strategy = make_strategy(
            self.config, self.plan, extent=self.frame.extent, may_grow=self._may_grow
        )
        if self.depth:
            self.depth.set_length(iterations)

    def _may_grow(self, means: np.ndarray) -> np.ndarray:
        """Return [N] bool: `means`, [N, 3], next to which splats may be added."""
        if self._block is None:
            return all_within(means)
        world = self.frame.similarity.points_from_training(means)
        return self._block.contains(world, self.frame.origin)

    @property
    def photo_factor(self) -> float:
        """Divisor of the photo's sides in the last step."""
        return self._view_batcher.factor

    def step(self) -> StepResult:
        """Render a view, compute its loss, and update the splats.

        Raises:
            GsError: the loss was not finite for many steps, or once under `detect_anomaly`.
            DatasetError, FormatError: a photo that is not cached is missing, damaged or changed;
                nothing was changed.
        """
        return self._step(1)

    def _step(self, count: int) -> StepResult:
        """Take a step of `count` views, one of them on this rank."""
        step = self.steps + count
        self.stage_timer = timer = StageTimer()
        cleared = self.pruner.guided.count
        for member in self.members:
            self._widen_to(member, self.plan.sh_degree_at(step))
        views = self._draw_views(step, count)
        timer.pixels = sum(one.view.width * one.view.height for one in views)
        timer.lap("photo")
        pairs = zip(self.members, views, strict=True)
        result = combine_results([self._step_of(*pair, step) for pair in pairs])
        self._note_skipped(result.skipped)
        return result._replace(cleared_rows=self.pruner.guided.count - cleared)

    def _draw_views(self, step: int, count: int) -> list[TrainingView]:
        """Draw the views of a step, one for each model."""
        return self._view_batcher.draw(self.plan, step, photos=count, models=len(self.members))

    def _step_of(
        self, member: EnsembleMember, training_view: TrainingView, step: int
    ) -> StepResult:
        """Take `step` for one of the models."""
        masked_tiles = Skip.MASKED_TILE in self.config.without
        photo = training_view.sized.photo(self.photos.mask_mode, masked_tiles=masked_tiles)
        self.engine.put(training_view.index, photo)
        request = self._request(member.place, training_view, step)
        numbers = self.engine.step(member.model, request).result()
        self.steps = step
        self.stage_timer.add(numbers.seconds, numbers.raster)
        self.lost_rows += numbers.lost_rows
        if numbers.costs:
            self._view_batcher.note_costs(training_view.indices, numbers.costs)
        result = StepResult(
            loss=numbers.loss,
            mse=numbers.mse,
            change=Change(),
            bad_rows=numbers.bad_rows,
            skipped=numbers.skipped,
            lost_rows=numbers.lost_rows,
        )
        if numbers.skipped:
            return result
        if request.learn_gain or request.learn_pose:
            self._learn_of_photos(training_view.indices, numbers.slopes)
        self.bad_rows += numbers.bad_rows
        change, lost_rows = self._after_step(member, step)
        self.stage_timer.lap("edit")
        return result._replace(change=change, lost_rows=lost_rows)

    def _request(self, place: int, training_view: TrainingView, step: int) -> StepRequest:
        """Request of a step to the engine."""
        config, plan, count = self.config, self.plan, len(training_view.indices)
        strategy, photos, factor = self.strategy, self.photo_parameters, self.rate_factor
        means_lr = factor * plan.means_lr_at(step) * math.sqrt(count)
        rates = {name: factor * rate for name, rate in plan.rates_at(step, count).items()}
        names, gain = self.photos.scene.cameras.names, training_view.gain
        others = list(training_view.indices)
        others.remove(training_view.index)
        return StepRequest(
            step=step,
            photo=training_view.index,
            view=training_view.view,
            others=tuple(self.renderer.view(i, self.photo_factor) for i in others),
            background=self.renderer.background_before_gain(training_view.background, gain),
            shown_background=training_view.background,
            gain=None if gain is None else as_color(gain),
            antialias=config.antialias,
            sh_degree=self._sh_degree_at(step),
            sh_update=self._rest_at(step, count),
            rates=rates | {"means": means_lr},
            seed=config.seed,
            place=place,
            drop_rate=drop_rate_at(self.drop_rate, step, plan.iterations),
            noise=strategy.noise_at(means_lr),
            terms=self._terms.terms,
            picture_term=self._terms.picture_term(training_view.index, step),
            opacity_reg=strategy.opacity_reg,
            scale_reg=strategy.scale_reg,
            observe=strategy.counters if strategy.observes_at(step) else (),
            learn_gain=photos.gains is not None,
            learn_pose=photos.pose_rate(step / plan.iterations) > 0,
            update_hidden=Skip.UNSEEN_SH in config.without,
            extent=self.frame.extent,
            disable=self._disable,
            check_finite=names[training_view.index] if config.detect_anomaly else "",
            compare=self.steps % SANITIZE_EVERY == 0,
        )

    def _after_step(self, member: EnsembleMember, step: int) -> tuple[Change, int]:
        """Densify, prune and sanitize after a step; returns the change, and the number of runaway
        rows that were reset."""
        config, plan, model, pruner = self.config, self.plan, member.model, self.pruner
        weights = partial(self._contributions, model)
        if plan.refines_at(step):
            self.engine.release()
        change = self._apply(model, pruner.prune_free_space(model.column, plan, step))
        change += self._apply(model, pruner.prune_masked(len(model), weights, plan, step))
        cap = plan.cap_for(self.photo_factor) - self._frozen_count
        refined = self.strategy.refine(model.column, step=step, cap=cap, generator=self.generator)
        change += self._apply(model, refined)
        if self.region is not None and self._given:
            inside = self.region.keep_inside(model.column("means"))
            self._apply(model, () if inside is None else (inside,))
        least = pruner.prune_least(len(model), weights, plan, step, pruned=member.pruned)
        pruned = self._apply(model, least)
        member.pruned += pruned.removed
        lost_rows = 0
        if step % SANITIZE_EVERY == 0:
            lost_rows = model.clamp_runaways(self.frame.extent)
            self.lost_rows += lost_rows
        if config.finest > 0 and plan.prunes_free_space_at(step):
            model.apply_min_scale(map(self.renderer.view, self.sampler.indices), config.finest)
        return change + pruned, lost_rows

    def error(self, views: int = 8) -> float:
        """Root mean squared error of the unmasked pixels in about `views` training views, at the
        resolution of the next step."""
        indices = self.sampler.indices
        chosen = indices[:: -(-len(indices) // views)]
        return self.renderer.error(chosen, self.plan.factor_at(self.steps + 1))

    def splats(self) -> Splats:
        """Return the current splats in COLMAP world units, with the SH degree in use; frozen ones
        first."""
        merged = self.engine.merged(self._all_models())
        return self._whole(self._in_world({name: p.copy() for name, p in merged.items()}))

    def parts(self) -> Iterator[Splats]:
        """Yield the rows of `splats` in parts, which are valid until the next step."""
        if self.frozen is not None:
            yield from self.frozen.parts(_ROWS_A_PART, self.model.sh_degree)
        for member in self.members:
            for at in range(0, len(member.model), _ROWS_A_PART):
                part = dict(member.model.part(at, at + _ROWS_A_PART))
                opacities = torch.from_numpy(part["opacities"])
                part["opacities"] = divide_opacities(opacities, len(self.members)).numpy()
                yield self._in_world(part)

    def free_memory(self) -> None:
        """Free the memory that the engine keeps between steps."""
        self.engine.release()

    def finish(self) -> Splats:
        """Return the final splats: as `splats`, but without copying a single model, and the memory
        of steps is freed. Views can still be rendered."""
        self.free_memory()
        for member in self.members:
            member.model.finish()
        return self._whole(self._in_world(self.engine.merged(self._all_models())))

    def release(self) -> None:
        """Free the state that `restore` replaces; only `restore` may be called next."""
        self.free_memory()
        for member in self.members:
            member.model.drop_moments()

    def state(self) -> dict[str, Any]:
        """State other than tensors, as JSON values."""
        found = {
            "steps": self.steps,
            "iterations": self.plan.iterations,
            "frame": self.frame.to_dict(),
            "bad_rows": self.bad_rows,
            "lost_rows": self.lost_rows,
            "known": self._known,
            "skipped": self._skipped,
        }
        for member in self.members:
            found |= member.state()
        return found | self._view_batcher.state() | self.pruner.state()

    def collect(self) -> None:
        """Collect the state that `tensors` needs; nothing to do for one process."""

    def tensors(self) -> dict[str, torch.Tensor]:
        """All tensors that the next step depends on, by name; no copies. Call `collect` first."""
        out = {"generator": self.generator.get_state()}
        for member in self.members:
            out |= member.tensors()
        return out | self.photo_parameters.tensors()

    def _decide_by_photos(self, known: float | None, models: int | None = None) -> None:
        """Decide on dropout and ensemble by the share of pixels with `known` depth; `models` is
        the number of models if it was decided before."""
        config, mask_mode = self.config, self.photos.mask_mode
        self._known = known
        self.drop_rate, dropout = drop_rate_of(config, known=known, mask_mode=mask_mode)
        """Dropout rate at the last step."""
        self._models, ensemble = self._models_for(known)
        if models is not None and models != self._models:
            self._models, ensemble = models, None
        self._by_photos = (dropout, ensemble)

    def _models_for(self, known: float | None) -> tuple[int, Decision | None]:
        """Number of models, and the decision if the photos led to it."""
        if self._given:
            return 1, None
        photos = self.photos
        return model_count(
            self.config,
            photos=len(photos.train),
            points=photos.scene.points.given,
            mask_mode=photos.mask_mode,
            known=known,
        )

    def _members_of(self, first: Splats) -> list[EnsembleMember]:
        """Create the ensemble members, each with a copy of these splats."""
        return [
            EnsembleMember(
                place,
                self.engine.model(
                    {name: getattr(first, name).copy() for name in PARAMETERS},
                    counters=self.strategy.counters,
                    frozen=None if self.frozen is None else self.frozen.columns,
                ),
            )
            for place in range(self._models)
        ]

    def _make_engine(self) -> Engine[Any]:
        return CpuEngine(threads=self.config.threads)

    def _all_models(self) -> list[EngineModel]:
        return [member.model for member in self.members]

    def restore(self, state: dict[str, Any], tensors: dict[str, torch.Tensor]) -> None:
        """Restore `state` and `tensors` of another trainer with this config, and take ownership of
        the tensors.

        The length of the run is that of the config, or stored with a time budget.

        Raises:
            ValueError, KeyError: `state` or `tensors` are invalid.
        """
        # Use the stored share, because a resumed run without stereo points skips stereo.
        known = self._known
        if state.get("known") is not None:
            known = as_float("known", state["known"], low=0)
        models, like = self._models_for(known)[0], self.model
        if (there := count_members(tensors)) != models:
            # The photos decided the number when the run started, perhaps by an older rule.
            by_photos = self.config.ensemble_below and there in {1, self.config.ensemble}
            if self._given or not by_photos:
                raise ValueError(f"it has {there} models, expected {models}")
            models = there
        members = [EnsembleMember(place, like) for place in range(models)]
        for member in members:
            member.check(tensors)
        if len({member.of(tensors)["param/shN"].shape[1] for member in members}) > 1:
            raise ValueError("its models have different SH degrees")
        self._send_restored(state, tensors)
        length = self.config.iterations
        if self.config.time_budget:
            length = as_int("iterations", state.get("iterations", length), low=1)
        self._decide_by_photos(known, models)
        self.replan(length)
        self.engine.release()
        self.members = members
        for member in members:
            member.restore(self.engine, state, tensors)
        self.photo_parameters.restore(self.sampler.indices, len(self.photos.scene.cameras), tensors)
        self.generator.set_state(tensors["generator"])
        self._view_batcher.restore(state)
        self.steps = as_int("steps", state["steps"])
        self.bad_rows = as_int("bad_rows", state["bad_rows"])
        self.lost_rows = as_int("lost_rows", state.get("lost_rows", 0))
        self._skipped = as_int("skipped", state["skipped"])
        self.pruner.restore(state)

    def _whole(self, trained: Splats) -> Splats:
        """Frozen splats followed by the `trained` ones, COLMAP world."""
        if self.frozen is None:
            return trained
        return joined([self.frozen.world, trained])

    def _send_restored(self, state: dict[str, Any], tensors: dict[str, torch.Tensor]) -> None:
        """Send the state to the other ranks; nothing to do for one process."""

    def _in_world(self, params: Columns) -> Splats:
        return self.frame.similarity.splats_from_training(Splats(**params))

    def _widen_to(self, member: EnsembleMember, degree: int) -> None:
        if member.model.sh_degree < degree:
            self.engine.release()
            member.model.widen_sh(degree)

    def _learn_of_photos(self, indices: Sequence[int], slopes: np.ndarray) -> None:
        """Update gains and poses by `slopes`, `StepNumbers.slopes`."""
        done = self.steps / self.plan.iterations
        # M models train on M photos per step, so each of their M updates has 1/M of the rate.
        factor = self.rate_factor / len(self.members)
        self.photo_parameters.learn(indices, slopes, done=done, factor=factor)

    def _sh_degree_at(self, step: int) -> int:
        """SH degree at `step`, at least that of the start splats."""
        return max(self.plan.sh_degree_at(step), self._given_degree)

    def _rest_at(self, step: int, count: int) -> ShUpdate:
        if self._sh_degree_at(step) == 0:
            return ShUpdate.OFF
        return ShUpdate.STEP if self.plan.harmonics_update_at(step, count) else ShUpdate.ACCUMULATE

    def _note_skipped(self, skipped: bool) -> None:
        self._skipped = self._skipped + 1 if skipped else 0
        if self._skipped >= _MAX_SKIPPED:
            raise GsError(
                f"Training diverged: the loss was not finite for "
                f"{count_words(_MAX_SKIPPED, 'step')} in a row, "
                f"the last one at step {self.steps}. Lower the learning rates; `--detect-anomaly` "
                "finds the first number that is not finite."
            )

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
            (sized.view, sized.photo(self.photos.mask_mode))
            for sized in self._view_batcher.training_views()
        )
        return self.engine.contributions(model, views, antialias=self.config.antialias)
