"""The training step and all state it depends on; no files, no events, no clock."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import torch

from ..config import Skip, TrainConfig
from ..errors import DatasetError, GsError
from ..formats.joined import joined
from ..io.block_record import BlockRecord
from ..raster.header import OUT_INVERSE_DEPTH
from ..raster.memory import zeros
from ..raster.painter import Picture
from ..raster.request import Frustum, Settings
from ..scene import PointCloud
from ..splats import Splats
from ..words import count_words, number
from .depth.loss import DepthLoss
from .depth.regularisers import drop_rate_at, drop_rate_of, drop_splats
from .depth.targets import DepthTargets
from .guide.loss import GuideLoss
from .guide.setup import GuideSetup
from .guide.space import KeptFree
from .host.laps import Laps
from .host.random import generator_of
from .photos.skips import raster_bits
from .photos.views import Photos, Sampler
from .ranks import losses, orders
from .ranks.agree import crc_of
from .ranks.member import Member, members_in
from .ranks.team import RankLostError, Team
from .region.box import Box
from .region.still import Still, parted
from .rows import bounds, finest, guard
from .rows.ensemble import shared_opacities
from .rows.frame import Frame
from .rows.model import Model, ShN
from .rows.params import splats_of_tensors, tensors_from_splats
from .rows.stored import real, whole
from .schedule.batches import photos_at_once
from .schedule.enough import models_of, splats_of_each
from .schedule.plan import Plan
from .step.glances import Glance, Glances
from .step.loss import LossAndGradients, StepLoss
from .step.result import StepResult, together
from .strategy import Change, DrawnView, everywhere, make_strategy, ops
from .strategy.first import first_splats
from .strategy.removal import Removal
from .views.gains import PhotoGains, without_background
from .views.learnt import Learnt, learnt_poses
from .views.placing import Placing
from .views.sight import Sight

_IN_CELL = (
    "Splats are added in the block's cell alone: those around it, which `gscore merge` leaves out, "
    "are there from the splats that were given."
)
_MAX_SKIPPED = 100
_ABSURD_MSE = 1e4
"""Pictures are 0 to 1; colours of 100 come from splats that ran away."""
_HOLD_EVERY = 100
"""Steps between two looks at the bounds of `bounds`."""
_ROWS_A_PART = 1 << 16
"""Splats that are looked at together where not all need be."""


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
        frame: Frame | None = None,
        start: Splats | None = None,
        depth: DepthTargets | None = None,
        points: PointCloud | None = None,
        known: float | None = None,
        gains: PhotoGains | None = None,
        placing: Placing | None = None,
        photo_cache: int | None = None,
        team: Team | None = None,
        region: Box | None = None,
        guide: GuideSetup | None = None,
        block: BlockRecord | None = None,
    ) -> None:
        """Start from `start` or from `points`, in COLMAP world, or from the points of the capture.

        `depth` holds what to supervise depth with; `known` is the share of the pixels that masks
        leave whose depth stereo found, None: nobody looked; `gains` how photos were exposed, which
        is learnt, None: they are taken as they are; `placing` where training cameras stand, None:
        where the capture has them; `photo_cache` is how many bytes of photos may be kept, None:
        all; `team` are the processes that train together, each of which makes such a trainer;
        `region`, in COLMAP world, holds the splats of `start` that are trained, None: all are;
        where there is no `start`, `photos` are those that are narrowed to it; `guide` are the
        meshes that guide the run; `block` is the one in whose cell alone splats are added, None:
        they are everywhere.

        Raises:
            DatasetError: nothing to train on.
            ConfigError: `start` has more splats than the config allows, or none in `region`.
        """
        if not photos.train:
            raise DatasetError(
                "The capture has no photos to train on: all views are held out for the test; "
                "hold out fewer."
            )
        self.config = config
        self.photos = photos
        self._given = start is not None
        self._judge(known)
        self.team = team
        """Those with whom each step is taken together; None: this process trains alone."""
        self.frame = frame or Frame.of(photos.scene, near=config.near)
        cloud = photos.scene.points if points is None else points
        most = splats_of_each(config, self._models)
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
        """The depth loss, where depth is supervised."""
        if depth is not None:
            self.depth = DepthLoss(config, depth, scale=self.frame.similarity.scale)
        self.guide: GuideLoss | None = None
        """The loss of a guide's surface, where there is one."""
        if guide is not None and guide.surface is not None:
            self.guide = GuideLoss(
                guide.surface, weight=config.guide_weight, scale=self.frame.similarity.scale
            )
        self.guide_digest = "" if guide is None else guide.digest
        """Changes with any of the meshes that guide the run; empty: none do."""
        self._block = block
        self.replan(config.iterations)
        self.generator = generator_of(config.seed)
        self.sampler = Sampler(photos.train)
        self.steps = 0
        """Steps taken."""
        self.bad_rows = 0
        """Gradient rows left out so far because they were not finite."""
        self.lost_rows = 0
        """Splats taken out so far because they ran away; see `bounds`."""
        self.rate_factor = 1.0
        """All learning rates are multiplied by this."""
        self._skipped = 0
        self.laps = Laps()
        """What the parts of the last step took."""
        cameras = self.frame.similarity.cameras_to_training(photos.scene.cameras)
        self.learnt = Learnt(config, gains, learnt_poses(placing, photos.train, self.frame))
        """How photos were exposed and where they were taken, as far as that is learnt."""
        self._v_viewmat = zeros(4, 4)
        self.region = None if region is None else region.in_training(self.frame.similarity)
        """The box that matters, training world; of given splats, those in it may not leave it."""
        self.still: Still | None = None
        """What stands around them and is drawn with them; None: nothing does."""
        if region is not None and start is not None:
            start, self.still = parted(start, region, config, self.frame)
        first, free_space = first_splats(
            config, photos, self.frame, self.plan, cameras, cloud, start=start, count=count
        )
        self.members = self._members_of(first)
        """The models that are trained side by side; of given splats there is one."""
        self.sight = Sight(
            config,
            photos,
            self.frame,
            cameras,
            self.learnt,
            lambda: [member.model for member in self.members],
            cache=photo_cache,
            still=self.still,
        )
        """The splats as cameras see them."""
        self._painter = self.sight.painter
        self._glances = Glances(
            config,
            self.sampler,
            self.sight,
            self.learnt,
            self.generator,
            mask_mode=photos.mask_mode,
            team=team,
        )
        self._loss = StepLoss(
            config, mask_mode=photos.mask_mode, depth=self.depth, guide=self.guide
        )
        self.removal = Removal(
            config,
            free_space,
            self._painter,
            self._glances.training_views,
            masks_hide=photos.mask_mode == "ignore",
            guided=KeptFree(guide.free, given, self.frame.similarity)
            if guide is not None and guide.free
            else None,
        )
        """What goes besides what the strategy takes out."""
        self._disable = raster_bits(config.without)
        self._given_degree = first.sh_degree
        self.cut_degree = max(0 if start is None else start.sh_degree, first.sh_degree)
        """SH degree of given splats before it was cut to what the config allows."""
        for member in self.members:
            if Skip.SH_BANDS in config.without:
                ops.widen_sh(member.model, config.sh_degree)
            self.strategy.start(member.model)

    @property
    def model(self) -> Model:
        """The splats of the first model with all that is kept for each of them."""
        return self.members[0].model

    @property
    def splat_count(self) -> int:
        """How many splats there are, with those that stand still."""
        return self.trained_count + self._standing

    @property
    def trained_count(self) -> int:
        """How many splats are trained."""
        return sum(len(member.model) for member in self.members)

    @property
    def _standing(self) -> int:
        return 0 if self.still is None else len(self.still)

    @property
    def region_words(self) -> str:
        """A sentence on the part of the splats that is trained, or where they are added; empty: all
        are, everywhere."""
        if self.region is None:
            return _IN_CELL if self._block else ""
        if not self._given:
            return "Only pixels that look at the region count."
        count = count_words(self.trained_count, "splat")
        return f"{count} in the region; {number(self._standing)} around it stand still."

    def plan_of(self, iterations: int) -> Plan:
        """The plan of a run of this length; costs next to nothing."""
        config = replace(self.config, iterations=iterations)
        return self._plan_of(config, drops=self.drop_rate > 0, models=self._models)

    def replan(self, iterations: int) -> None:
        """Change the length of the run: from the next step on all schedules are those of a run
        that is `iterations` steps long."""
        self.plan = self.plan_of(iterations)
        """When things happen."""
        self.strategy = make_strategy(
            self.config, self.plan, extent=self.frame.extent, may_grow=self._may_grow
        )
        if self.depth:
            self.depth.set_length(iterations)

    def _may_grow(self, means: torch.Tensor) -> torch.Tensor:
        """[N] bool: beside which of `means` [N, 3] splats may be added."""
        if self._block is None:
            return everywhere(means)
        world = self.frame.similarity.points_from_training(means.numpy())
        return torch.from_numpy(self._block.holds(world, self.frame.origin))

    @property
    def photo_factor(self) -> float:
        """What the sides of the photo of the last step were divided by."""
        return self._glances.factor

    def step(self) -> StepResult:
        """Render a view, compare it with the photo, improve the splats.

        A team takes as many views at once as it has ranks, each rank another one, and `steps` goes
        up by as many. Rank 0 calls for the step; the others, who heard that, call this too.

        Raises:
            GsError: the loss was not finite for many steps, or once under `detect_anomaly`.
            DatasetError, FormatError: a photo that is not kept in memory is missing, damaged or
                another one than it was, on any rank; the step was not begun.
            RankLostError: another process is gone.
        """
        if self.team is None:
            return self._step(1)
        self.team.say(orders.take_step(self.plan.iterations, self.rate_factor))
        with self.team.stepping():
            return self._step(self._photos_at_once(self.team))

    def _step(self, count: int) -> StepResult:
        """A step that takes `count` views at once, on this rank one of them."""
        step, laps = self.steps + count, Laps()
        self.laps = laps
        self.sight.forget()
        cleared = self.removal.guided.count
        for member in self.members:
            self._widen_to(member, self.plan.sh_degree_at(step))
        try:
            glances = self._glances.draw(self.plan, step, photos=count, models=len(self.members))
        except RankLostError:
            raise
        except GsError:
            self._collect_now()
            raise
        laps.pixels = sum(glance.view.width * glance.view.height for glance in glances)
        laps.lap("photo")
        pairs = zip(self.members, glances, strict=True)
        result = together([self._step_of(member, glance, step) for member, glance in pairs])
        self._note_skipped(result.skipped)
        return result._replace(cleared_rows=self.removal.guided.count - cleared)

    def _step_of(self, member: Member, glance: Glance, step: int) -> StepResult:
        """The part of `step` that one of the models takes."""
        config, model, laps, count = self.config, member.model, self.laps, len(glance.indices)
        for index in glance.indices:  # also for those of other ranks, whose rows are then the same
            model.settle_for(self.sight.view(index, self.photo_factor), threads=config.threads)
        laps.lap("settle")
        opacities, leaf = self._step_opacities(model, step)
        picture = self._draw(model, glance, opacities, step)
        laps.lap("draw")
        loss = self._loss.of(picture, glance, step)
        values, errors = self._of_all(member, glance, loss)
        value, mse = sum(values) / count, sum(errors) / count
        self.steps = step
        laps.lap("loss")
        self._assert_finite(model, glance, value)
        # What breaks a loss is often a splat that ran away; the next views do without it.
        sane = math.isfinite(value) and all(found < _ABSURD_MSE for found in errors)
        lost_rows = 0 if sane else self._hold(model)
        if lost_rows or not math.isfinite(value):
            return StepResult(value, mse, Change(), 0, True, lost_rows)
        v_means2d = self._gradients(member, glance, picture, loss, opacities, leaf)
        laps.add_raster(self._painter.stats())
        self._assert_finite(model, glance, value)
        change, bad_rows = self._learn(member, step, v_means2d, glance.view, count)
        self.bad_rows += bad_rows
        pruned = self.removal.prune(model, self.plan, step, pruned=member.pruned)
        member.pruned += pruned
        change = replace(change, removed=change.removed + pruned)
        laps.lap("learn")
        lost_rows = self._hold(model) if step % _HOLD_EVERY == 0 else 0
        if config.finest > 0 and self.plan.clears_at(step):
            finest.widen(model, map(self.sight.view, self.sampler.indices), config.finest)
        return StepResult(value, mse, change, bad_rows, False, lost_rows)

    def _draw(self, model: Model, glance: Glance, opacities: torch.Tensor, step: int) -> Picture:
        config, counts = self.config, self._loss.looks_at_depth(glance, step)
        return self._painter.draw(
            tuple((model.params | {"opacities": opacities}).values()),
            glance.view,
            Settings(
                sh_degree=self._sh_degree_at(step),
                background=self.sight.behind(glance.background, glance.gain),
                antialias=config.antialias,
                outputs=OUT_INVERSE_DEPTH if counts else 0,
                threads=config.threads,
                disable=self._disable,
                tiles=None if Skip.MASKED_TILE in config.without else glance.sized.tiles,
            ),
        )

    def _of_all(
        self, member: Member, glance: Glance, loss: LossAndGradients
    ) -> tuple[list[float], list[float]]:
        """Losses and mean squared errors of all photos of a batch.

        Raises:
            DatasetError: another rank's photo cannot be had; nothing was done.
        """
        if self.team is None or member.batch is None:
            return [loss.value], [loss.mse]
        count = len(glance.indices)
        sizes = member.batch.sizes(self._painter.radii, count)
        try:
            found = losses.of_all(
                self.team,
                loss.value,
                loss.mse,
                cost=self._painter.stats()["entries"],
                photos=count,
                mark=self._mark(member.model),
                sizes=sizes,
            )
        except DatasetError:
            self._glances.put_back(count)
            self._collect_now()
            raise
        member.batch.hear(found.sizes)
        self._glances.note_costs(glance.indices, found.costs)
        return found.values, found.errors

    def _gradients(
        self,
        member: Member,
        glance: Glance,
        picture: Picture,
        loss: LossAndGradients,
        opacities: torch.Tensor,
        leaf: torch.Tensor | None,
    ) -> torch.Tensor:
        """Fill the model's gradients, and let gains and poses learn of theirs; returns those in
        the splats' places in the picture."""
        model, batch = member.model, member.batch
        moves = self.learnt.pose_rate(self.steps / self.plan.iterations) > 0
        v_means2d = self._painter.gradients(
            batch.into(model, len(glance.indices)) if batch else model.grads,
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
        if glance.gain is not None and self.photos.mask_mode == "composite":
            v_log_gain = without_background(
                v_log_gain, glance.background, glance.gain, loss.v_rgb, picture.alpha
            )
        self._learn_of_photos(glance.indices, v_log_gain)
        return v_means2d

    def error(self, views: int = 8) -> float:
        """Root of the mean squared error of the pixels that count, in some training views at the
        next step's resolution."""
        indices = self.sampler.indices
        chosen = indices[:: -(-len(indices) // views)]
        return self.sight.error(chosen, self.plan.factor_at(self.steps + 1))

    def splats(self) -> Splats:
        """The splats as they are now, in COLMAP world, with the SH degrees in use so far; first
        those that stand still."""
        shown = self.sight.splats()
        return self._whole(self._in_world({name: p.clone() for name, p in shown.items()}))

    def parts(self) -> Iterator[Splats]:
        """What `splats` gives, some rows at a time, which are only good until the next step."""
        if self.still is not None:
            yield from self.still.parts(_ROWS_A_PART, self.model.sh_degree)
        for member in self.members:
            for at in range(0, len(member.model), _ROWS_A_PART):
                rows = slice(at, at + _ROWS_A_PART)
                part = member.model.settled_rows(rows, threads=self.config.threads)
                opacities = shared_opacities(part["opacities"], len(self.members))
                yield self._in_world(part | {"opacities": opacities})

    def make_room(self) -> None:
        """Give back what the rasterizer keeps from step to step, before something else takes
        memory."""
        self.sight.forget()
        self._painter.release()

    def finish(self) -> Splats:
        """What `splats` gives, when no step will follow: of one model without a copy, and the
        memory that only steps need is given back. Views can still be drawn."""
        self.make_room()
        for member in self.members:
            member.model.settle(threads=self.config.threads)
            member.model.drop_moments()
        return self._whole(self._in_world(self.sight.splats()))

    def release(self) -> None:
        """Give back what `restore` will replace; until then nothing else may be asked for."""
        self.make_room()
        for member in self.members:
            member.model.drop_moments()

    def state(self) -> dict[str, Any]:
        """What is not a tensor, as JSON values."""
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
        return found | self._glances.state() | self.removal.state()

    def collect(self) -> None:
        """Bring what other ranks know alone to rank 0, which calls for it."""
        if self.team and not self._collected:
            self.team.say(orders.collect())
            self._collect_now()

    def _collect_now(self) -> None:
        """As `collect`, where all ranks are about to end for the same error."""
        for member in self.members:
            if member.batch and not member.batch.complete:
                member.batch.collect(member.model)

    @property
    def _collected(self) -> bool:
        """Whether rank 0 knows all that a checkpoint needs; the same on all ranks."""
        return all(member.batch is None or member.batch.complete for member in self.members)

    def tensors(self) -> dict[str, torch.Tensor]:
        """All tensors that the next step depends on, by name; no copies. Of a team, those of this
        rank; after `collect` rank 0 has all."""
        out = {"generator": self.generator.get_state()}
        for member in self.members:
            out |= member.tensors()
        return out | self.learnt.tensors()

    def _judge(self, known: float | None, models: int | None = None) -> None:
        """Decide what photos decide by the share of their pixels whose depth is `known`, but for
        the number of `models` if that was decided before."""
        config, mask_mode = self.config, self.photos.mask_mode
        self._known = known
        self.drop_rate, self.drop_words = drop_rate_of(config, known=known, mask_mode=mask_mode)
        """Share of the splats that is left out of the last step, and a sentence on it where these
        photos decide; empty: none are, or the options say so."""
        self._models, self.ensemble_words = self._models_for(known)
        if models is not None and models != self._models:
            self._models, self.ensemble_words = models, ""

    def _models_for(self, known: float | None) -> tuple[int, str]:
        """How many models there are, and a sentence on them where these photos decide that."""
        if self._given:
            return 1, ""
        photos = self.photos
        return models_of(
            self.config,
            photos=len(photos.train),
            points=photos.scene.points.given,
            mask_mode=photos.mask_mode,
            known=known,
        )

    def _members_of(self, first: Splats) -> list[Member]:
        """As many models as there are to be, all of these splats."""
        return [
            Member(place, Model(tensors_from_splats(first)), self.team)
            for place in range(self._models)
        ]

    def restore(self, state: dict[str, Any], tensors: dict[str, torch.Tensor]) -> None:
        """Go on from what `state` and `tensors` of another trainer with this config returned; the
        tensors are taken over. Rank 0 hands both to all others of its team.

        The length of the run is that of the config, unless a time budget leaves it open.

        Raises:
            ValueError, KeyError: they are not what those return.
        """
        # What was found of the photos then: a run that stereo gave no points does not ask it again.
        known = self._known
        if state.get("known") is not None:
            known = real("known", state["known"], low=0)
        models, like = self._models_for(known)[0], self.model
        if (there := members_in(tensors)) != models:
            # Photos decided on them when the run began, by the rule of then.
            by_photos = self.config.ensemble_below and there in {1, self.config.ensemble}
            if self._given or not by_photos:
                raise ValueError(f"it has {there} models, expected {models}")
            models = there
        members = [Member(place, like, self.team) for place in range(models)]
        for member in members:
            member.check(tensors, like)
        if len({member.of(tensors)["param/shN"].shape[1] for member in members}) > 1:
            raise ValueError("its models have different SH degrees")
        if self.team and self.team.leads:
            self.team.say(orders.restore(state))
            self.team.share(tensors)
        length = self.config.iterations
        if self.config.time_budget:
            length = whole("iterations", state.get("iterations", length), low=1)
        self._judge(known, models)
        self.replan(length)
        rank, size = (self.team.rank, self.team.size) if self.team else (0, 1)
        self._painter.release()
        self.sight.forget()
        self.members = members
        for member in members:
            member.restore(state, tensors, rank=rank, size=size)
        self.learnt.restore(self.sampler.indices, len(self.photos.scene.cameras), tensors)
        self.generator.set_state(tensors["generator"])
        self._glances.restore(state)
        self.steps = whole("steps", state["steps"])
        self.bad_rows = whole("bad_rows", state["bad_rows"])
        self.lost_rows = whole("lost_rows", state.get("lost_rows", 0))
        self._skipped = whole("skipped", state["skipped"])
        self.removal.restore(state)

    def _whole(self, trained: Splats) -> Splats:
        """`trained` splats after those that stand still, COLMAP world."""
        if self.still is None:
            return trained
        return joined([self.still.world, trained])

    def _in_world(self, params: dict[str, torch.Tensor]) -> Splats:
        return self.frame.similarity.splats_from_training(splats_of_tensors(params))

    def _widen_to(self, member: Member, degree: int) -> None:
        if member.model.sh_degree < degree:
            self._painter.release()
            ops.widen_sh(member.model, degree)
            if member.batch:
                member.batch.forget()

    def _learn_of_photos(
        self, indices: Sequence[int], v_log_gain: tuple[float, float, float]
    ) -> None:
        """Let gains and poses take their steps; the derivatives are those of this rank's photo."""
        done = self.steps / self.plan.iterations
        if self.learnt.gains is None and not self.learnt.pose_rate(done):
            return
        mine = [*v_log_gain, *self._v_viewmat.flatten().tolist()]
        slopes = self.team.numbers(mine) if self.team else np.array([mine])
        # Each model has its own photo: as many more steps, each as much shorter.
        factor = self.rate_factor / len(self.members)
        self.learnt.learn(indices, slopes, done=done, factor=factor)

    def _step_opacities(self, model: Model, step: int) -> tuple[torch.Tensor, torch.Tensor | None]:
        """The opacities that this step draws, and, where they are not the model's own, the leaf
        that their gradients belong to."""
        opacities = model.params["opacities"]
        rate = drop_rate_at(self.drop_rate, step, self.plan.iterations)
        if rate <= 0:
            return opacities, None
        leaf = opacities.detach().requires_grad_()
        return drop_splats(leaf, rate, self.generator), leaf

    def _sh_degree_at(self, step: int) -> int:
        """The degree in use; that of given splats from the start."""
        return max(self.plan.sh_degree_at(step), self._given_degree)

    def _rest_at(self, step: int, count: int) -> ShN:
        if self._sh_degree_at(step) == 0:
            return ShN.OFF
        return ShN.STEP if self.plan.rest_moves_at(step, count) else ShN.GATHER

    def _photos_at_once(self, team: Team) -> int:
        plan, config = self.plan, self.config
        return photos_at_once(
            team.size,
            self.steps,
            every=(
                *(plan.refine_every, plan.reset_every, plan.kept_every),
                *(config.snapshot_every, _HOLD_EVERY),
            ),
            marks=(
                *config.save_iterations,
                *config.test_iterations,
                *config.checkpoint_iterations,
            ),
            end=plan.iterations,
        )

    def _mark(self, model: Model) -> float:
        """A number of the splats, where a team compares them: as often as they are held."""
        return float(crc_of(model.params)) if self.steps % _HOLD_EVERY == 0 else 0.0

    def _assert_finite(self, model: Model, glance: Glance, value: float) -> None:
        if self.config.detect_anomaly:
            name = self.photos.scene.cameras.names[glance.index]
            guard.assert_finite(model, value, step=self.steps, view=name)

    def _note_skipped(self, skipped: bool) -> None:
        self._skipped = self._skipped + 1 if skipped else 0
        if self._skipped >= _MAX_SKIPPED:
            raise GsError(
                f"Training diverged: the loss was not finite for "
                f"{count_words(_MAX_SKIPPED, 'step')} in a row, "
                f"the last one step {self.steps}. Lower the learning rates; --detect-anomaly says "
                "where it begins."
            )

    def _hold(self, model: Model) -> int:
        lost = bounds.hold(model, extent=self.frame.extent)
        self.lost_rows += lost
        return lost

    def _learn(
        self, member: Member, step: int, v_means2d: torch.Tensor, view: Frustum, count: int
    ) -> tuple[Change, int]:
        """Step with the model's gradients; what changed, and how many rows were left out."""
        model, batch, radii = member.model, member.batch, self._painter.radii
        counters = batch.counters(model) if batch else model.rows
        drawn = DrawnView(
            step=step, radii=radii, v_means2d=v_means2d, width=view.width, height=view.height
        )
        self.strategy.observe(counters, drawn)
        if batch:
            radii = batch.add_up(
                model, counters=counters, photos=count, threads=self.config.threads
            )
        self.strategy.shape_gradients(model)
        factor, plan = self.rate_factor, self.plan
        means_lr = factor * plan.means_lr_at(step) * math.sqrt(count)
        rates = {name: factor * rate for name, rate in plan.rates_at(step, count).items()}
        model.set_rates(rates | {"means": means_lr})
        shown = None if Skip.UNSEEN_SH in self.config.without else radii
        rest = self._rest_at(step, count)
        if batch:
            batch.add_up_rest(model, rest, threads=self.config.threads)
        bad_rows = model.step(shown, shN=rest, photos=count, threads=self.config.threads)
        if self.plan.refines_at(step):
            self._painter.release()
        removed = self.removal.clear(model, self.plan, step)
        removed += self.removal.unveil(model, self.plan, step)
        change = self.strategy.after_step(
            model,
            step=step,
            means_lr=means_lr,
            cap=self.plan.cap_for(self.photo_factor) - self._standing,
            generator=self.generator,
        )
        if self.region is not None and self._given:
            self.region.keep_inside(model.params["means"])
        return replace(change, removed=change.removed + removed), bad_rows
