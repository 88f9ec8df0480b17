"""Trainer: the training step and all state it depends on; no files, events or clock."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from ..config import Skip, TrainConfig
from ..engine.base import Engine, EngineModel
from ..engine.opening import open_engine
from ..engine.random import generator_of
from ..engine.stage_timer import StageTimer
from ..errors import BackendError
from ..splats import Splats
from .analysis.analysis import Analysis
from .analysis.photo_rules import photo_rules
from .distributed.process_group import ProcessGroup
from .estimate.device_memory import photo_room
from .model.checkpoint_schema import as_int
from .model.ensemble_member import EnsembleMember, count_members
from .model.training_frame import TrainingFrame
from .photos.image_pyramid import ImagePyramid
from .photos.view_sampler import ViewSampler, mixed
from .schedule.plan import Plan
from .step.model_set import ModelSet
from .step.photo_comparison import PhotoComparison
from .step.photo_errors import PhotoErrors
from .step.step_edits import StepEdits
from .step.step_queue import RequestedStep, StepQueue, StepStart
from .step.step_requests import LossTerms, StepRequests, check_engine
from .step.step_result import StepCounts, StepResult, combine_results, result_of
from .step.training_start import training_start
from .step.training_views import TrainingView, ViewBatcher
from .strategy import in_cell, make_strategy
from .views.model_renderer import ModelRenderer
from .views.photo_blurs import PhotoBlurs
from .views.photo_gains import HeldOutGains
from .views.photo_parameters import PhotoParameters, initial_poses
from .views.transients import Transients


class Trainer:
    """Splats in training. The same inputs give the same bits, for any number of threads.

    All randomness comes from one generator, that of steps from their seed, step and row; everything
    that is summed over splats or pixels is summed in a fixed order. Run it with
    `torch.set_num_threads(1)`, see `session`.
    """

    group: ProcessGroup | None = None
    """Process group of a distributed training; None: one process."""

    def __init__(
        self, config: TrainConfig, analysis: Analysis, engine: Engine[Any] | None = None
    ) -> None:
        """Start from the splats or points of `analysis`.

        Args:
            config: Training options.
            analysis: The capture and what was found out about it.
            engine: Computes the steps; None: that of the device in `config`.

        Raises:
            DatasetError: no training photos.
            ConfigError: more start splats than the config allows, or none in the region.
        """
        self.config = config
        self.photos = photos = analysis.photos
        self.rules = photo_rules(config, analysis)
        """Decisions on dropout, ensemble and region."""
        self.frame = analysis.frame or TrainingFrame.of(photos.scene, near=config.near)
        scale, weight = self.frame.similarity.scale, self.rules.opaque_weight
        self._terms = LossTerms(config, analysis, opaque_weight=weight, scale=scale)
        self.depth = self._terms.depth
        """The depth loss; None: no depth supervision."""
        self.guide_digest = analysis.guide.digest
        """Hash of the guide meshes; empty: none."""
        self._may_grow = in_cell(analysis.block, self.frame)
        self.replan(config.iterations)
        self.generator = generator_of(config.seed)
        self.sampler = ViewSampler(photos.train)
        self.counts = StepCounts()
        """Steps taken, and what was skipped or reset in them."""
        self.rate_factor = 1.0
        """Factor of all learning rates."""
        self.stage_timer = StageTimer()
        """Seconds of the stages of the last step."""
        given, stops = photos.scene.cameras, analysis.facts.stops
        cameras = self.frame.similarity.cameras_to_training(given)
        poses = initial_poses(analysis.pose_check, photos.train, self.frame)
        held_out = HeldOutGains(given.names, given.centers, photos.train, stops=stops)
        blurs = transients = None
        if config.photo_blur and self.group is None:
            blurs = PhotoBlurs(photos.train, np.maximum(given.widths, given.heights))
        if self.group is None and _may_mask_transients(config, analysis):
            transients = Transients(photos.train)
        self.photo_parameters = PhotoParameters(
            config, analysis.gains, poses, blurs, transients, held_out
        )
        """Exposure gains, camera poses, blurs and masks of the photos."""
        self.region = analysis.region and analysis.region.in_training(self.frame.similarity)
        """The region box, training frame; its start splats are kept inside."""
        start = training_start(
            config, analysis, self.frame, self.plan, cameras, count=self.rules.points
        )
        self.engine = engine or open_engine(config.device, threads=config.threads)[0]
        """Computes the steps."""
        drops, frozen = self.rules.drop_rate > 0, start.frozen is not None
        room = photo_room(self.engine.info.memory, config, given, models=self.rules.models)
        self.engine.keep_photos(room)
        check_engine(self.engine.info, config, analysis, self._terms, drops=drops, frozen=frozen)
        self.models = ModelSet(
            self.engine,
            self.frame.similarity,
            start.first,
            count=self.rules.models,
            counters=self.strategy.counters,
            frozen=start.frozen,
        )
        """Models that are trained in parallel; one with start splats."""
        self.renderer = ModelRenderer(
            config,
            photos,
            self.frame,
            ImagePyramid(
                photos,
                cameras,
                near=self.frame.near,
                limit=analysis.photo_cache,
                threads=config.threads,
            ),
            self.photo_parameters,
            self.engine,
            lambda: self.models.models,
            region=frozen,
        )
        """Renderer of the current model."""
        self.view_batcher = ViewBatcher(
            config,
            self.sampler,
            self.renderer,
            self.photo_parameters,
            self.generator,
            group=self.group,
        )
        self._comparison = PhotoComparison(
            self.renderer, self.photo_parameters, self.sampler.indices
        )
        self.pruner = start.pruner
        """Pruning in addition to that of the strategy."""
        self._edits = StepEdits(
            config,
            self.engine,
            self.pruner,
            self.renderer,
            self.view_batcher,
            self.generator,
            region=self.region if self.rules.given else None,
            extent=self.frame.extent,
        )
        self._requests = StepRequests(
            config,
            self._terms,
            self.renderer,
            self.photo_parameters,
            names=given.names,
            extent=self.frame.extent,
            first_degree=start.first.sh_degree,
        )
        self._queue = StepQueue(self.engine)
        self._used: list[bool] = []
        """Whether each model took the last step that was read, or skipped it."""
        self.photo_errors = PhotoErrors()
        """Errors of the training photos in their last steps, since the start or resume."""
        self._requesting: StepStart | None = None
        """State before the step that is being requested, or whose request failed."""
        self._requested_models = 0
        """Models of which that step was requested."""
        self.cut_degree = start.cut_degree
        """SH degree of the start splats before it was cut to that of the config."""
        if Skip.SH_BANDS in config.without:
            self.models.widen_sh(config.sh_degree)

    @property
    def model(self) -> EngineModel:
        """The first model: splats with their moments and counters."""
        return self.models.first

    @property
    def steps(self) -> int:
        """Number of steps taken."""
        return self.counts.steps

    @property
    def splat_count(self) -> int:
        """Number of splats, frozen ones included."""
        return self.models.trained_count + self.models.frozen_count

    def plan_of(self, iterations: int) -> Plan:
        """Return the plan of a run with `iterations` steps; cheap."""
        config = replace(self.config, iterations=iterations)
        return self.rules.plan(config, self.photos, self.frame.extent)

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

    def step(self) -> StepResult:
        """Take a step and return its result, see `advance`."""
        return (*self.advance(), *self.read_all())[-1]

    def advance(self) -> list[StepResult]:
        """Render a view, compute its loss, and update the splats.

        Returns:
            The results that are read, in the order of steps: of the step that the engine's number
            of steps in flight lies before this one, or of all where they decide what follows.

        Raises:
            GsError: the loss was not finite for many steps, or once under `detect_anomaly`.
            DatasetError, FormatError: a photo that is not cached is missing, damaged or changed;
                nothing was changed.
            BackendError: the engine failed.
        """
        return self._advance(1)

    def read_all(self) -> list[StepResult]:
        """Wait for all steps and return the results that were not read."""
        return self._read(0)

    def abandon(self) -> list[StepResult]:
        """Forget the steps from the first that failed on, which changed nothing, so that they are
        taken again with the same bits; returns the results of those before it that were not read.

        Raises:
            BackendError: some models have taken a step and others have not.
        """
        if self._requested_models:
            raise BackendError("Some models have taken a step more than others.")
        results: list[StepResult] = []
        with suppress(BackendError):
            results = self._read(0)
        views, start = self._queue.clear()
        self.counts.steps -= views
        if start := start or self._requesting:
            self._restore_views(start.views, start.photos, start.generator)
            self._queue.used = start.used
        return results

    @property
    def compares_photos(self) -> bool:
        """True if photos are compared with the models before the next step."""
        return self._comparison.due(self.plan.compare_steps, self.steps)

    def compare_photos(self) -> Iterator[None]:
        """Measure transients and blur of the photos where they are due; yields after each photo.

        To be called after `read_all`. If it is not run to its end, what was not measured for all
        photos stays as it was, and the next step measures that.
        """
        factor = min(self.view_batcher.factor, self.plan.factor_at(self.steps + 1))
        return self._comparison.run(self.plan.compare_steps, self.steps, factor)

    def _advance(self, count: int) -> list[StepResult]:
        """Take a step of `count` views, one of them on this rank."""
        step, timer = self.steps + count, StageTimer()
        self.stage_timer = timer
        earlier = []
        if self.compares_photos:
            earlier = self._read(0)
            for _ in self.compare_photos():
                pass
            timer.lap("compare")
        self.models.widen_sh(self.plan.sh_degree_at(step))
        self._requesting, self._requested_models = self._start(), 0
        views = self._draw_views(step, count)
        timer.pixels = sum(one.view.width * one.view.height for one in views)
        timer.lap("photo")
        requested = []
        for member, training_view in zip(self.models.members, views, strict=True):
            requested.append(self._requested(member, training_view, step))
            self._requested_models += 1
        self._queue.add(step, requested, self._requesting)
        self._requesting, self._requested_models = None, 0
        self.counts.steps = step
        edits = self._edits.due_at(self.plan, step, self.models.members)
        kept = step % self.plan.kept_every == 0 or step >= self.plan.iterations
        results = self._read(0 if edits or kept else self._queue.depth)
        if edits:
            results[-1] = self._edited(results[-1])
        timer.lap("edit")
        return [*earlier, *results]

    def _start(self) -> StepStart | None:
        """State before the next step; None: the engine reads each step at once."""
        if not self._queue.depth:
            return None
        photos = {name: one.copy() for name, one in self.photo_parameters.arrays().items()}
        generator = self.generator.get_state()
        return StepStart(self.view_batcher.state(), generator, photos, self._queue.used)

    def _draw_views(self, step: int, count: int) -> list[TrainingView]:
        """Draw the views of a step, one for each model."""
        return self.view_batcher.draw(self.plan, step, photos=count, models=self.rules.models)

    def _requested(
        self, member: EnsembleMember, training_view: TrainingView, step: int
    ) -> RequestedStep:
        """Request `step` of one of the models."""
        masked_tiles = Skip.MASKED_TILE in self.config.without
        photo = training_view.sized.photo(self.photos.mask_mode, masked_tiles=masked_tiles)
        request = self._requests.of(
            training_view,
            self.plan,
            self.strategy,
            step,
            place=member.place,
            rate_factor=self.rate_factor,
            drop_rate=self.rules.drop_rate,
        )
        return self._queue.request(member.model, request, photo, training_view.indices)

    def _read(self, most: int) -> list[StepResult]:
        """Read results until at most `most` steps are unread, and use the slopes that are due."""
        results = []
        for answers in self._queue.read(most):
            for one, found in answers:
                self.stage_timer.add(found.seconds, found.raster)
                self.photo_errors.note(one.indices, found.mse)
                if found.costs:
                    self.view_batcher.note_costs(one.indices, found.costs)
            self._used = [not found.skipped for _, found in answers]
            result = combine_results([result_of(found, len(one.indices)) for one, found in answers])
            self.counts.note(result)
            results.append(result)
        self._learn_of_photos(self.steps - self._queue.depth)
        return results

    def _edited(self, result: StepResult) -> StepResult:
        """Densify, prune and sanitize the models that took the step of `result`."""
        took = [one for one, used in zip(self.models.members, self._used, strict=True) if used]
        frozen = self.models.frozen_count
        edited = self._edits.apply(result, took, self.plan, self.strategy, frozen=frozen)
        self.counts.lost_rows += edited.lost_rows - result.lost_rows
        return edited

    def error(self, views: int = 8, factor: float | None = None) -> float:
        """Root mean squared error of the unmasked pixels in `views` training views, with sides
        divided by `factor`; None: at the resolution of the next step."""
        if factor is None:
            factor = self.plan.factor_at(self.steps + 1)
        return self.renderer.error(mixed(self.sampler.indices, views), factor)

    def splats(self) -> Splats:
        """Current splats in COLMAP world units, with the SH degree in use; frozen ones first."""
        return self.models.splats()

    def finish(self) -> Splats:
        """Return the final splats: as `splats`, but without copying a single model, and the memory
        of steps is freed. Views can still be rendered."""
        self._learn_of_photos(self.steps)
        return self.models.finish()

    def release(self) -> None:
        """Free the state that `restore` replaces; only `restore` may be called next."""
        self._queue.drop()
        self.models.drop_moments()

    def state(self) -> dict[str, Any]:
        """State other than tensors, as JSON values."""
        found = {"iterations": self.plan.iterations, "known": self.rules.known}
        found |= {"frame": self.frame.to_dict()} | self.counts.state() | self.models.state()
        return found | self.view_batcher.state() | self.pruner.state()

    def collect(self) -> None:
        """Collect the state that `tensors` needs; nothing to do for one process."""

    def tensors(self) -> dict[str, torch.Tensor]:
        """All tensors that the next step depends on, by name; no copies. Call `read_all` and
        `collect` first."""
        out = {"generator": self.generator.get_state()} | self._queue.tensors()
        photos = self.photo_parameters.arrays()
        return out | self.models.tensors() | {n: torch.from_numpy(a) for n, a in photos.items()}

    def restore(self, state: dict[str, Any], tensors: dict[str, torch.Tensor]) -> None:
        """Restore `state` and `tensors` of another trainer with this config, and take ownership of
        the tensors.

        The length of the run is that of the config, or stored with a time budget.

        Raises:
            ValueError, KeyError: `state` or `tensors` are invalid.
        """
        rules = self.rules.restored(self.config, self.photos, state, count_members(tensors))
        members = self.models.checked(tensors, rules.models)
        self._send_restored(state, tensors)
        length = self.config.iterations
        if self.config.time_budget:
            length = as_int("iterations", state.get("iterations", length), low=1)
        self.rules = rules
        self.replan(length)
        self.models.restore(members, state, tensors)
        self._queue.restore(tensors)
        photos = {name: tensor.numpy() for name, tensor in tensors.items()}
        self._restore_views(state, photos, tensors["generator"])
        self.counts.restore(state)
        self.pruner.restore(state)

    def _restore_views(
        self, state: dict[str, Any], photos: Mapping[str, np.ndarray], generator: torch.Tensor
    ) -> None:
        """Restore photo parameters, the order of views, and the random numbers."""
        self.photo_parameters.restore(self.sampler.indices, len(self.photos.scene.cameras), photos)
        self.generator.set_state(generator)
        self.view_batcher.restore(state)

    def _send_restored(self, state: dict[str, Any], tensors: dict[str, torch.Tensor]) -> None:
        """Send the state to the other ranks; nothing to do for one process."""

    def _learn_of_photos(self, until: int) -> None:
        """Update gains and poses by the slopes of steps up to `until`."""
        # M models train on M photos per step, so each of their M updates has 1/M of the rate.
        factor = self.rate_factor / len(self.models.members)
        for step, index, slopes in self._queue.slopes_until(until):
            done = step / self.plan.iterations
            self.photo_parameters.learn([index], slopes[None], done=done, factor=factor)


def _may_mask_transients(config: TrainConfig, analysis: Analysis) -> bool:
    """Return whether a training may mask transients: of whole scenes from their points. Depth maps
    and guide meshes would be used where a photo is masked."""
    is_whole = not analysis.is_part and config.start_splats is None
    is_opaque = analysis.photos.mask_mode != "composite"
    by_photos = analysis.depth is None and analysis.guide.surface is None
    return config.transient_masks and is_whole and is_opaque and by_photos
