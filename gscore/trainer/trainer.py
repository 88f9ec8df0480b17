"""Trainer: the training step and all state it depends on; no files, events or clock."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import torch

from ..config import Skip, TrainConfig
from ..engine.base import RowEdit
from ..engine.cpu import finite_check
from ..engine.cpu.model import CpuModel, ShUpdate
from ..engine.cpu.noise import add_noise, add_regularisers
from ..engine.random import generator_of
from ..errors import DatasetError, GsError
from ..formats.joined import joined
from ..io.block_record import BlockRecord
from ..raster.header import OUT_INVERSE_DEPTH
from ..raster.memory import zeros
from ..raster.request import Frustum, Settings
from ..raster.screen_gradients import add_screen_gradients
from ..raster.training_rasterizer import Picture
from ..scene import PointCloud
from ..splats import Splats
from ..text_format import count_words, number
from .depth.loss import DepthLoss
from .depth.regularisers import drop_rate_at, drop_rate_of, drop_splats
from .depth.targets import DepthTargets
from .distributed import batch_losses, rank_commands
from .distributed.consistency import crc_of
from .distributed.ensemble_member import EnsembleMember, count_members
from .distributed.process_group import ProcessGroup, RankLostError
from .guide.loss import GuideLoss
from .guide.mesh_free_space import MeshFreeSpace
from .guide.setup import GuideSetup
from .host.stage_timer import StageTimer
from .model.checkpoint_schema import as_float, as_int
from .model.conversion import splats_from_tensors, tensors_from_splats
from .model.ensemble import divide_opacities
from .model.training_frame import TrainingFrame
from .photos.raster_skips import disabled_skips
from .photos.view_sampler import Photos, ViewSampler
from .region.frozen_splats import FrozenSplats, split_frozen
from .region.region_box import RegionBox
from .schedule.batch_size import batch_size
from .schedule.caps import max_splats_per_model, model_count
from .schedule.plan import Plan
from .step.step_loss import LossAndGradients, StepLoss
from .step.step_result import StepResult, combine_results
from .step.training_views import TrainingView, ViewBatcher
from .strategy import Change, all_within, make_strategy
from .strategy.contribution import Weights, weights_by_view
from .strategy.initialization import initial_splats
from .strategy.pruning import Pruner
from .views.model_renderer import ModelRenderer
from .views.photo_gains import PhotoGains, without_background
from .views.photo_parameters import PhotoParameters, initial_poses
from .views.pose_check import PoseCheck

_IN_CELL = (
    "Splats are added only in the block's cell: the start splats cover its surroundings, which "
    "`gscore merge` leaves out."
)
_MAX_SKIPPED = 100
_ABSURD_MSE = 1e4
"""Mean squared error that only runaway splats cause: colours of 100 where photos have 0 to 1."""
_SANITIZE_EVERY = 100
"""Steps between two sanitizing passes, see `engine.cpu.sanitize`."""
_ROWS_A_PART = 1 << 16
"""Splats per part of `parts`."""


class Trainer:
    """Splats in training. The same inputs give the same bits, for any number of threads.

    All randomness comes from one generator; everything that is summed over splats or pixels is
    summed in a fixed order. Run it with `torch.set_num_threads(1)`, see `session`.
    """

    def __init__(
        self,
        config: TrainConfig,
        photos: Photos,
        *,
        frame: TrainingFrame | None = None,
        start: Splats | None = None,
        depth: DepthTargets | None = None,
        points: PointCloud | None = None,
        known: float | None = None,
        gains: PhotoGains | None = None,
        pose_check: PoseCheck | None = None,
        photo_cache: int | None = None,
        team: ProcessGroup | None = None,
        region: RegionBox | None = None,
        guide: GuideSetup | None = None,
        block: BlockRecord | None = None,
    ) -> None:
        """Start from `start` or `points`, or from the points of the capture.

        Args:
            config: Training options.
            photos: The capture; with a `region` and no `start`, masked to the region.
            frame: Training frame; None: fitted to the capture.
            start: Start splats, COLMAP world.
            depth: Targets of depth supervision.
            points: Start points, COLMAP world.
            known: Share of the unmasked pixels with stereo depth; None: stereo did not run.
            gains: Initial exposure gains; None: photo colours are used unchanged.
            pose_check: Checked training cameras; None: those of the capture.
            photo_cache: Bytes of photos to keep in memory; None: all.
            team: Process group of a distributed training; each rank has a trainer.
            region: Box of the splats of `start` that are trained, COLMAP world; None: all.
            guide: Guide meshes.
            block: Block whose cell limits where splats are added; None: everywhere.

        Raises:
            DatasetError: no training photos.
            ConfigError: `start` has more splats than the config allows, or none in `region`.
        """
        if not photos.train:
            raise DatasetError(
                "The capture has no training photos, because all views are held out for the test; "
                "hold out fewer."
            )
        self.config = config
        self.photos = photos
        self._given = start is not None
        self._decide_by_photos(known)
        self.team = team
        """Process group of a distributed training; None: one process."""
        self.frame = frame or TrainingFrame.of(photos.scene, near=config.near)
        cloud = photos.scene.points if points is None else points
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
        if depth is not None:
            self.depth = DepthLoss(config, depth, scale=self.frame.similarity.scale)
        self.guide: GuideLoss | None = None
        """The loss of the surface mesh; None: no surface mesh."""
        if guide is not None and guide.surface is not None:
            self.guide = GuideLoss(
                guide.surface, weight=config.guide_weight, scale=self.frame.similarity.scale
            )
        self.guide_digest = "" if guide is None else guide.digest
        """Hash of the guide meshes; empty: none."""
        self._block = block
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
        self.laps = StageTimer()
        """Seconds of the stages of the last step."""
        cameras = self.frame.similarity.cameras_to_training(photos.scene.cameras)
        self.photo_parameters = PhotoParameters(
            config, gains, initial_poses(pose_check, photos.train, self.frame)
        )
        """Optimised exposure gains and camera poses of the photos."""
        self._v_viewmat = zeros(4, 4)
        self.region = None if region is None else region.in_training(self.frame.similarity)
        """The region box, training frame; its start splats are kept inside."""
        self.frozen: FrozenSplats | None = None
        """Frozen splats around the region, rendered with the trained ones; None: none."""
        if region is not None and start is not None:
            start, self.frozen = split_frozen(start, region, config, self.frame)
        first, free_space = initial_splats(
            config, photos, self.frame, self.plan, cameras, cloud, start=start, count=count
        )
        self.members = self._members_of(first)
        """Models that are trained in parallel; one with start splats."""
        self.renderer = ModelRenderer(
            config,
            photos,
            self.frame,
            cameras,
            self.photo_parameters,
            lambda: [member.model for member in self.members],
            cache=photo_cache,
            frozen=self.frozen,
        )
        """Renderer of the current model."""
        self._rasterizer = self.renderer.rasterizer
        self._view_batcher = ViewBatcher(
            config,
            self.sampler,
            self.renderer,
            self.photo_parameters,
            self.generator,
            mask_mode=photos.mask_mode,
            team=team,
        )
        self._loss = StepLoss(
            config, mask_mode=photos.mask_mode, depth=self.depth, guide=self.guide
        )
        self.pruner = Pruner(
            config,
            free_space,
            masks_hide=photos.mask_mode == "ignore",
            guided=MeshFreeSpace(guide.free, given, self.frame.similarity)
            if guide is not None and guide.free
            else None,
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
    def model(self) -> CpuModel:
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
    def region_words(self) -> str:
        """Message on the trained region, or on the cell in which splats are added; empty: no
        limit."""
        if self.region is None:
            return _IN_CELL if self._block else ""
        if not self._given:
            return "Only pixels that show the region are trained."
        count = count_words(self.trained_count, "splat")
        return f"{count} in the region; {number(self._frozen_count)} around it are frozen."

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

        R ranks render R different views in one step, and `steps` rises by R. Rank 0 broadcasts the
        step; the workers then call this too.

        Raises:
            GsError: the loss was not finite for many steps, or once under `detect_anomaly`.
            DatasetError, FormatError: a photo that is not cached is missing, damaged or changed,
                on any rank; nothing was changed.
            RankLostError: another process is gone.
        """
        if self.team is None:
            return self._step(1)
        self.team.broadcast(rank_commands.take_step(self.plan.iterations, self.rate_factor))
        with self.team.stepping():
            return self._step(self._photos_at_once(self.team))

    def _step(self, count: int) -> StepResult:
        """Take a step of `count` views, one of them on this rank."""
        step, laps = self.steps + count, StageTimer()
        self.laps = laps
        self.renderer.forget()
        cleared = self.pruner.guided.count
        for member in self.members:
            self._widen_to(member, self.plan.sh_degree_at(step))
        try:
            view_batcher = self._view_batcher.draw(
                self.plan, step, photos=count, models=len(self.members)
            )
        except RankLostError:
            raise
        except GsError:
            self._collect_now()
            raise
        laps.pixels = sum(
            training_view.view.width * training_view.view.height for training_view in view_batcher
        )
        laps.lap("photo")
        pairs = zip(self.members, view_batcher, strict=True)
        result = combine_results(
            [self._step_of(member, training_view, step) for member, training_view in pairs]
        )
        self._note_skipped(result.skipped)
        return result._replace(cleared_rows=self.pruner.guided.count - cleared)

    def _step_of(
        self, member: EnsembleMember, training_view: TrainingView, step: int
    ) -> StepResult:
        """Take `step` for one of the models."""
        config, model, laps, count = (
            self.config,
            member.model,
            self.laps,
            len(training_view.indices),
        )
        for (
            index
        ) in training_view.indices:  # views of other ranks too, so that rows stay equal on all
            model.sync_visible(self.renderer.view(index, self.photo_factor), threads=config.threads)
        laps.lap("settle")
        opacities, leaf = self._step_opacities(model, step)
        picture = self._draw(model, training_view, opacities, step)
        laps.lap("draw")
        loss = self._loss.of(picture, training_view, step)
        values, errors = self._of_all(member, training_view, loss)
        value, mse = sum(values) / count, sum(errors) / count
        self.steps = step
        laps.lap("loss")
        self._assert_finite(model, training_view, value)
        # A loss that is not finite often comes from one runaway splat; reset it immediately.
        sane = math.isfinite(value) and all(found < _ABSURD_MSE for found in errors)
        lost_rows = 0 if sane else self._sanitize(model)
        if lost_rows or not math.isfinite(value):
            return StepResult(value, mse, Change(), 0, True, lost_rows)
        v_means2d = self._gradients(member, training_view, picture, loss, opacities, leaf)
        laps.add_raster(self._rasterizer.stats())
        self._assert_finite(model, training_view, value)
        change, bad_rows = self._learn(member, step, v_means2d, training_view.view, count)
        self.bad_rows += bad_rows
        least = self.pruner.prune_least(
            len(model), partial(self._weights, model), self.plan, step, pruned=member.pruned
        )
        pruned = self._apply(model, least)
        member.pruned += pruned.removed
        change += pruned
        laps.lap("learn")
        lost_rows = self._sanitize(model) if step % _SANITIZE_EVERY == 0 else 0
        if config.finest > 0 and self.plan.prunes_free_space_at(step):
            model.apply_min_scale(map(self.renderer.view, self.sampler.indices), config.finest)
        return StepResult(value, mse, change, bad_rows, False, lost_rows)

    def _draw(
        self, model: CpuModel, training_view: TrainingView, opacities: torch.Tensor, step: int
    ) -> Picture:
        config, counts = self.config, self._loss.uses_depth(training_view, step)
        return self._rasterizer.draw(
            tuple((model.params | {"opacities": opacities}).values()),
            training_view.view,
            Settings(
                sh_degree=self._sh_degree_at(step),
                background=self.renderer.background_before_gain(
                    training_view.background, training_view.gain
                ),
                antialias=config.antialias,
                outputs=OUT_INVERSE_DEPTH if counts else 0,
                threads=config.threads,
                disable=self._disable,
                tiles=None if Skip.MASKED_TILE in config.without else training_view.sized.tiles,
            ),
        )

    def _of_all(
        self, member: EnsembleMember, training_view: TrainingView, loss: LossAndGradients
    ) -> tuple[list[float], list[float]]:
        """Return the losses and mean squared errors of all photos of a batch.

        Raises:
            DatasetError: another rank cannot read its photo; nothing was changed.
        """
        if self.team is None or member.batch is None:
            return [loss.value], [loss.mse]
        count = len(training_view.indices)
        sizes = member.batch.sizes(self._rasterizer.radii, count)
        try:
            found = batch_losses.of_all(
                self.team,
                loss.value,
                loss.mse,
                cost=self._rasterizer.stats()["entries"],
                photos=count,
                mark=self._mark(member.model),
                sizes=sizes,
            )
        except DatasetError:
            self._view_batcher.put_back(count)
            self._collect_now()
            raise
        member.batch.receive(found.sizes)
        self._view_batcher.note_costs(training_view.indices, found.costs)
        return found.values, found.errors

    def _gradients(
        self,
        member: EnsembleMember,
        training_view: TrainingView,
        picture: Picture,
        loss: LossAndGradients,
        opacities: torch.Tensor,
        leaf: torch.Tensor | None,
    ) -> torch.Tensor:
        """Compute the model's gradients, and update gains and poses; returns the gradients in the
        projected means, [N, 2]."""
        model, batch = member.model, member.batch
        moves = self.photo_parameters.pose_rate(self.steps / self.plan.iterations) > 0
        v_means2d = self._rasterizer.gradients(
            batch.into(model, len(training_view.indices)) if batch else model.grads,
            loss.v_rgb,
            loss.v_alpha,
            loss.v_inverse_depth,
            viewmat=self._v_viewmat if moves else None,
        )
        if leaf is not None:
            grad = model.grads["opacities"]
            grad.copy_(torch.autograd.grad(opacities, leaf, grad)[0])
        self.laps.lap("gradients")
        v_log_gain = loss.v_log_gain
        if training_view.gain is not None and self.photos.mask_mode == "composite":
            v_log_gain = without_background(
                v_log_gain, training_view.background, training_view.gain, loss.v_rgb, picture.alpha
            )
        self._learn_of_photos(training_view.indices, v_log_gain)
        return v_means2d

    def error(self, views: int = 8) -> float:
        """Root mean squared error of the unmasked pixels in about `views` training views, at the
        resolution of the next step."""
        indices = self.sampler.indices
        chosen = indices[:: -(-len(indices) // views)]
        return self.renderer.error(chosen, self.plan.factor_at(self.steps + 1))

    def splats(self) -> Splats:
        """Return the current splats in COLMAP world units, with the SH degree in use; frozen ones
        first."""
        shown = self.renderer.splats()
        return self._whole(self._in_world({name: p.clone() for name, p in shown.items()}))

    def parts(self) -> Iterator[Splats]:
        """Yield the rows of `splats` in parts, which are valid until the next step."""
        if self.frozen is not None:
            yield from self.frozen.parts(_ROWS_A_PART, self.model.sh_degree)
        for member in self.members:
            for at in range(0, len(member.model), _ROWS_A_PART):
                rows = slice(at, at + _ROWS_A_PART)
                part = member.model.synced_rows(rows, threads=self.config.threads)
                opacities = divide_opacities(part["opacities"], len(self.members))
                yield self._in_world(part | {"opacities": opacities})

    def free_memory(self) -> None:
        """Free the memory that the rasterizer keeps between steps."""
        self.renderer.forget()
        self._rasterizer.release()

    def finish(self) -> Splats:
        """Return the final splats: as `splats`, but without copying a single model, and the memory
        of steps is freed. Views can still be rendered."""
        self.free_memory()
        for member in self.members:
            member.model.sync(threads=self.config.threads)
            member.model.drop_moments()
        return self._whole(self._in_world(self.renderer.splats()))

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
        """Collect on rank 0 the state that only other ranks have; called on rank 0."""
        if self.team and not self._collected:
            self.team.broadcast(rank_commands.collect())
            self._collect_now()

    def _collect_now(self) -> None:
        """As `collect`, without a broadcast, because all ranks end with the same error."""
        for member in self.members:
            if member.batch and not member.batch.complete:
                member.batch.collect(member.model)

    @property
    def _collected(self) -> bool:
        """True if rank 0 has the whole state of a checkpoint; equal on all ranks."""
        return all(member.batch is None or member.batch.complete for member in self.members)

    def tensors(self) -> dict[str, torch.Tensor]:
        """All tensors that the next step depends on, by name; no copies. With several ranks, those
        of this rank; after `collect`, rank 0 has all."""
        out = {"generator": self.generator.get_state()}
        for member in self.members:
            out |= member.tensors()
        return out | self.photo_parameters.tensors()

    def _decide_by_photos(self, known: float | None, models: int | None = None) -> None:
        """Decide on dropout and ensemble by the share of pixels with `known` depth; `models` is
        the number of models if it was decided before."""
        config, mask_mode = self.config, self.photos.mask_mode
        self._known = known
        self.drop_rate, self.drop_words = drop_rate_of(config, known=known, mask_mode=mask_mode)
        """Dropout rate at the last step, and a message on it if the photos decided; empty: no
        dropout, or set by the options."""
        self._models, self.ensemble_words = self._models_for(known)
        if models is not None and models != self._models:
            self._models, self.ensemble_words = models, ""

    def _models_for(self, known: float | None) -> tuple[int, str]:
        """Number of models, and a message if the photos decided it."""
        if self._given:
            return 1, ""
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
                CpuModel(tensors_from_splats(first), counters=self.strategy.counters),
                self.team,
            )
            for place in range(self._models)
        ]

    def restore(self, state: dict[str, Any], tensors: dict[str, torch.Tensor]) -> None:
        """Restore `state` and `tensors` of another trainer with this config, and take ownership of
        the tensors. Rank 0 sends both to the other ranks.

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
        members = [EnsembleMember(place, like, self.team) for place in range(models)]
        for member in members:
            member.check(tensors, like)
        if len({member.of(tensors)["param/shN"].shape[1] for member in members}) > 1:
            raise ValueError("its models have different SH degrees")
        if self.team and self.team.is_rank0:
            self.team.broadcast(rank_commands.restore(state))
            self.team.share(tensors)
        length = self.config.iterations
        if self.config.time_budget:
            length = as_int("iterations", state.get("iterations", length), low=1)
        self._decide_by_photos(known, models)
        self.replan(length)
        rank, size = (self.team.rank, self.team.size) if self.team else (0, 1)
        self._rasterizer.release()
        self.renderer.forget()
        self.members = members
        for member in members:
            member.restore(state, tensors, rank=rank, size=size)
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

    def _in_world(self, params: dict[str, torch.Tensor]) -> Splats:
        return self.frame.similarity.splats_from_training(splats_from_tensors(params))

    def _widen_to(self, member: EnsembleMember, degree: int) -> None:
        if member.model.sh_degree < degree:
            self._rasterizer.release()
            member.model.widen_sh(degree)
            if member.batch:
                member.batch.forget()

    def _learn_of_photos(
        self, indices: Sequence[int], v_log_gain: tuple[float, float, float]
    ) -> None:
        """Update gains and poses; `v_log_gain` is of this rank's photo."""
        done = self.steps / self.plan.iterations
        if self.photo_parameters.gains is None and not self.photo_parameters.pose_rate(done):
            return
        mine = [*v_log_gain, *self._v_viewmat.flatten().tolist()]
        slopes = self.team.all_gather(mine) if self.team else np.array([mine])
        # M models train on M photos per step, so each of their M updates has 1/M of the rate.
        factor = self.rate_factor / len(self.members)
        self.photo_parameters.learn(indices, slopes, done=done, factor=factor)

    def _step_opacities(
        self, model: CpuModel, step: int
    ) -> tuple[torch.Tensor, torch.Tensor | None]:
        """Return the opacities of this step, and the leaf tensor of their gradients if dropout
        changes them."""
        opacities = model.params["opacities"]
        rate = drop_rate_at(self.drop_rate, step, self.plan.iterations)
        if rate <= 0:
            return opacities, None
        leaf = opacities.detach().requires_grad_()
        return drop_splats(leaf, rate, self.generator), leaf

    def _sh_degree_at(self, step: int) -> int:
        """SH degree at `step`, at least that of the start splats."""
        return max(self.plan.sh_degree_at(step), self._given_degree)

    def _rest_at(self, step: int, count: int) -> ShUpdate:
        if self._sh_degree_at(step) == 0:
            return ShUpdate.OFF
        return ShUpdate.STEP if self.plan.harmonics_update_at(step, count) else ShUpdate.ACCUMULATE

    def _photos_at_once(self, team: ProcessGroup) -> int:
        plan, config = self.plan, self.config
        return batch_size(
            team.size,
            self.steps,
            every=(
                *(plan.refine_every, plan.reset_every, plan.kept_every),
                *(config.snapshot_every, _SANITIZE_EVERY),
            ),
            marks=(
                *config.save_iterations,
                *config.test_iterations,
                *config.checkpoint_iterations,
            ),
            end=plan.iterations,
        )

    def _mark(self, model: CpuModel) -> float:
        """CRC of the splats every `_SANITIZE_EVERY` steps, for comparison between ranks; else 0."""
        return float(crc_of(model.params)) if self.steps % _SANITIZE_EVERY == 0 else 0.0

    def _assert_finite(self, model: CpuModel, training_view: TrainingView, value: float) -> None:
        if self.config.detect_anomaly:
            name = self.photos.scene.cameras.names[training_view.index]
            finite_check.assert_finite(model, value, step=self.steps, view=name)

    def _note_skipped(self, skipped: bool) -> None:
        self._skipped = self._skipped + 1 if skipped else 0
        if self._skipped >= _MAX_SKIPPED:
            raise GsError(
                f"Training diverged: the loss was not finite for "
                f"{count_words(_MAX_SKIPPED, 'step')} in a row, "
                f"the last one at step {self.steps}. Lower the learning rates; `--detect-anomaly` "
                "finds the first number that is not finite."
            )

    def _sanitize(self, model: CpuModel) -> int:
        lost = model.clamp_runaways(self.frame.extent)
        self.lost_rows += lost
        return lost

    def _learn(
        self, member: EnsembleMember, step: int, v_means2d: torch.Tensor, view: Frustum, count: int
    ) -> tuple[Change, int]:
        """Update the model with its gradients; returns the changes and the number of rows with
        gradients that were not finite."""
        model, batch, radii = member.model, member.batch, self._rasterizer.radii
        counters = batch.counters(model) if batch else model.rows
        if self.strategy.observes_at(step):
            sums, views = (counters[name] for name in self.strategy.counters)
            scale, threads = (0.5 * view.width, 0.5 * view.height), self.config.threads
            add_screen_gradients(sums, views, v_means2d, radii, scale, threads=threads)
        if batch:
            radii = batch.add_up(
                model, counters=counters, photos=count, threads=self.config.threads
            )
        strategy = self.strategy
        add_regularisers(model, opacity_reg=strategy.opacity_reg, scale_reg=strategy.scale_reg)
        factor, plan = self.rate_factor, self.plan
        means_lr = factor * plan.means_lr_at(step) * math.sqrt(count)
        rates = {name: factor * rate for name, rate in plan.rates_at(step, count).items()}
        model.set_rates(rates | {"means": means_lr})
        shown = None if Skip.UNSEEN_SH in self.config.without else radii
        rest = self._rest_at(step, count)
        if batch:
            batch.sum_harmonics(model, rest, threads=self.config.threads)
        bad_rows = model.step(shown, shN=rest, photos=count, threads=self.config.threads)
        if self.plan.refines_at(step):
            self._rasterizer.release()
        cap = self.plan.cap_for(self.photo_factor) - self._frozen_count
        change = self._apply(model, self.pruner.prune_free_space(model.column, plan, step))
        masked = self.pruner.prune_masked(len(model), partial(self._weights, model), plan, step)
        change += self._apply(model, masked)
        change += self._apply(
            model, strategy.refine(model.column, step=step, cap=cap, generator=self.generator)
        )
        add_noise(model, strategy.noise_at(means_lr), self.generator)
        if self.region is not None and self._given:
            inside = self.region.keep_inside(model.column("means"))
            self._apply(model, () if inside is None else (inside,))
        return change, bad_rows

    def _apply(self, model: CpuModel, edits: Iterable[RowEdit]) -> Change:
        """Apply edits, each before the next is decided; returns what they change."""
        change = Change()
        for edit in edits:
            if edit.moves_rows:
                self._rasterizer.release()
            change += Change.of(edit, len(model))
            model.edit(edit)
        return change

    def _weights(self, model: CpuModel) -> Iterator[Weights]:
        """Contributions of the splats to all training views, at the size of the last step."""
        return weights_by_view(
            self._rasterizer,
            model.params,
            self._view_batcher.training_views(),
            antialias=self.config.antialias,
            masks_hide=self.photos.mask_mode == "ignore",
            scratch=model.grads,  # free after the step
            threads=self.config.threads,
        )
