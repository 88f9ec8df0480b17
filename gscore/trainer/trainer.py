"""The training step and all state it depends on; no files, no events, no clock."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch

from ..config import Background, Skip, TrainConfig
from ..errors import DatasetError, GsError
from ..formats.joined import joined
from ..io.block_record import BlockRecord
from ..raster.header import OUT_INVERSE_DEPTH
from ..raster.loss import image_loss_gradient
from ..raster.memory import empty, zeros
from ..raster.painter import Picture
from ..raster.request import Frustum, Settings
from ..scene import Cameras, PointCloud
from ..splats import Splats
from ..words import count_words, number
from .depth.loss import DepthLoss
from .depth.regularisers import drop_rate_at, drop_rate_of, drop_splats, opacity_loss, see_through
from .depth.targets import DepthTargets
from .guide.loss import GuideLoss
from .guide.setup import GuideSetup
from .guide.space import KeptFree
from .host.laps import Laps
from .host.random import generator_of, uniform
from .photos.pyramid import AHEAD, Sized
from .photos.skips import raster_bits
from .photos.sky import sky_splats
from .photos.views import Photos, Sampler
from .ranks import losses, orders
from .ranks.agree import crc_of
from .ranks.alike import alike_together
from .ranks.gradients import BatchGradients, gathered_of
from .ranks.team import Team
from .region.box import Box
from .region.still import Still, parted
from .rows import bounds, finest, guard
from .rows.frame import Frame
from .rows.model import Model, Moments, ShN
from .rows.near import Nearest
from .rows.params import splats_of_tensors, tensors_from_splats
from .rows.start import splats_of_cloud, splats_to_go_on_with
from .rows.stored import check_tensors, choices, measurements, real, whole
from .schedule.batches import photos_at_once
from .schedule.plan import Plan
from .strategy import Change, DrawnView, everywhere, make_strategy, ops
from .strategy.free_space import FreeSpace
from .strategy.removal import Removal
from .views.gains import PhotoGains, without_background
from .views.learnt import Learnt, learnt_poses
from .views.placing import Placing
from .views.sight import COLORS, Sight, mse_of_counted

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


class StepResult(NamedTuple):
    """What a step measured and did."""

    loss: float
    mse: float
    """Mean squared error of the view's pixels that count, before the step."""
    change: Change
    """What the strategy did."""
    bad_rows: int
    """Splats whose gradients were not finite and were left out."""
    skipped: bool
    """The loss was not finite or came from splats that ran away, so nothing was learnt."""
    lost_rows: int = 0
    """Splats that ran away and were taken out."""
    cleared_rows: int = 0
    """Splats that were taken out before a guide."""


class _Turn(NamedTuple):
    """What a step looks at."""

    indices: list[int]
    """Views of the batch, one for each rank."""
    index: int
    """This rank's view."""
    sized: Sized
    """It, with its photo."""
    background: tuple[float, float, float]
    gain: torch.Tensor | None
    """[3]: how its photo was exposed, where that is learnt."""
    depth_terms: list[tuple[float, DepthLoss | GuideLoss]]
    """Losses of its inverse depth, by maps and by a guide, with their weights."""

    @property
    def view(self) -> Frustum:
        """This rank's view."""
        return self.sized.view


class _Loss(NamedTuple):
    """What a picture of this rank's view is worth, and the gradients in it besides that in RGB."""

    value: float
    mse: float
    """Mean squared error of the pixels that count."""
    v_log_gain: tuple[float, float, float]
    v_alpha: torch.Tensor | None
    """[H, W]; None: the loss does not depend on it."""
    v_inverse_depth: torch.Tensor | None
    """As `v_alpha`."""


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
        self._known = known
        self.drop_rate, self.drop_words = self._drops()
        """Share of the splats that is left out of the last step, and a sentence on it where these
        photos decide; empty: none are, or the options say so."""
        self.team = team
        """Those with whom each step is taken together; None: this process trains alone."""
        self.frame = frame or Frame.of(photos.scene, near=config.near)
        cloud = photos.scene.points if points is None else points
        count = min(len(cloud), config.max_splats) if start is None else len(start)
        given = photos.scene.cameras
        self._plan_of = partial(
            Plan.of,
            extent=self.frame.extent,
            points=count,
            side=int(min(given.widths.min(), given.heights.min())),
            pixels=int((given.widths * given.heights)[list(photos.train)].mean()),
            subject=photos.mask_mode == "composite",
        )
        self._factor = math.inf
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
        self._costs: dict[int, float] = {}
        """What drawing each view took when a team last did; the same on all ranks."""
        self.steps = 0
        """Steps taken."""
        self.bad_rows = 0
        """Gradient rows left out so far because they were not finite."""
        self.lost_rows = 0
        """Splats taken out so far because they ran away; see `bounds`."""
        self.rate_factor = 1.0
        """All learning rates are multiplied by this."""
        self._skipped = 0
        self._v_rgb = empty(0)
        self._batch = BatchGradients(team) if team else None
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
        self._given = start is not None
        if region is not None and start is not None:
            start, self.still = parted(start, region, config, self.frame)
        first, free_space = self._first_splats(start, cloud, count, cameras)
        self.sight = Sight(
            config,
            photos,
            self.frame,
            cameras,
            self.learnt,
            Model(tensors_from_splats(first)),
            cache=photo_cache,
            still=self.still,
        )
        """The splats as cameras see them."""
        self._painter = self.sight.painter
        self.removal = Removal(
            config,
            free_space,
            self._painter,
            self._training_views,
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
        if Skip.SH_BANDS in config.without:
            ops.widen_sh(self.model, config.sh_degree)
        self.strategy.start(self.model)

    @property
    def model(self) -> Model:
        """The splats with all that is kept for each of them."""
        return self.sight.model

    @property
    def splat_count(self) -> int:
        """How many splats there are, with those that stand still."""
        return len(self.model) + self._standing

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
        count = count_words(len(self.model), "splat")
        return f"{count} in the region; {number(self._standing)} around it stand still."

    def plan_of(self, iterations: int) -> Plan:
        """The plan of a run of this length; costs next to nothing."""
        config = replace(self.config, iterations=iterations)
        return self._plan_of(config, drops=self.drop_rate > 0)

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
        return torch.from_numpy(self._block.holds(world))

    @property
    def photo_factor(self) -> float:
        """What the sides of the photo of the last step were divided by."""
        return self._factor

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
        step, config, model = self.steps + count, self.config, self.model
        cleared = self.removal.guided.count
        laps = self.laps = Laps()
        self._widen_to(self.plan.sh_degree_at(step))
        turn = self._turn(step, count)
        laps.pixels = turn.view.width * turn.view.height
        laps.lap("photo")
        for index in turn.indices:  # also for those of other ranks, whose rows are then the same
            model.settle_for(self.sight.view(index, self._factor), threads=config.threads)
        laps.lap("settle")
        opacities, leaf = self._step_opacities(step)
        picture = self._draw(turn, opacities, step)
        laps.lap("draw")
        loss = self._compare(turn, picture)
        values, errors = self._of_all(turn, loss)
        value, mse = sum(values) / count, sum(errors) / count
        self.steps = step
        laps.lap("loss")
        self._assert_finite(turn, value)
        # What breaks a loss is often a splat that ran away; the next views do without it.
        sane = math.isfinite(value) and all(found < _ABSURD_MSE for found in errors)
        lost_rows = 0 if sane else self._hold()
        if lost_rows or not math.isfinite(value):
            return self._skip(value, mse, lost_rows)
        self._skipped = 0
        v_means2d = self._gradients(turn, picture, loss, opacities, leaf)
        laps.raster = self._painter.stats()
        self._assert_finite(turn, value)
        change, bad_rows = self._learn(step, v_means2d, turn.view, count)
        self.bad_rows += bad_rows
        pruned = self.removal.prune(model, self.plan, step)
        change = replace(change, removed=change.removed + pruned)
        laps.lap("learn")
        lost_rows = self._hold() if step % _HOLD_EVERY == 0 else 0
        if config.finest > 0 and self.plan.clears_at(step):
            finest.widen(model, map(self.sight.view, self.sampler.indices), config.finest)
        cleared = self.removal.guided.count - cleared
        return StepResult(value, mse, change, bad_rows, False, lost_rows, cleared)

    def _turn(self, step: int, count: int) -> _Turn:
        """Draw the views of a step and take out this rank's photo.

        Raises:
            DatasetError, FormatError: it cannot be had; nothing was done.
        """
        indices = self._next_views(count)
        # A rank that has no view in a batch looks at another's and keeps what it finds to itself.
        place = min(self.team.rank, count - 1) if self.team else 0
        index = indices[place]
        # A run that becomes longer does not go back to smaller photos.
        self._factor = min(self._factor, self.plan.factor_at(step))
        try:
            sized = self.sight.sized(index, self._factor, upcoming=self._upcoming())
        except GsError as error:  # a checkpoint can be gone on from
            self.sampler.put_back(count)
            if self.team:
                losses.fail(self.team, error)
                self._collect_now()
            raise
        return _Turn(
            indices=indices,
            index=index,
            sized=sized,
            background=[self._step_background() for _ in range(count)][place],
            gain=self.learnt.gain_of(index),
            depth_terms=self._depth_terms(index, step),
        )

    def _next_views(self, count: int) -> list[int]:
        """The views of a batch; in a team of photos that cost alike."""
        views = []
        for missing in range(count, 0, -1):
            if self.team and self.sampler.through:
                self.sampler.begin(self.generator)
                size = self.team.size
                self.sampler.order = alike_together(
                    self.sampler.order, self._costs, size, first=missing % size
                )
            views.append(self.sampler.next(self.generator))
        return views

    def _depth_terms(self, index: int, step: int) -> list[tuple[float, DepthLoss | GuideLoss]]:
        """Losses of the inverse depth of a view that count at a step, with their weights."""
        found: list[tuple[float, DepthLoss | GuideLoss]] = []
        if self.depth:
            found.append((self.depth.weight(index, step), self.depth))
        if self.guide:
            found.append((self.guide.weight(index), self.guide))
        return [(weight, loss) for weight, loss in found if weight > 0]

    def _draw(self, turn: _Turn, opacities: torch.Tensor, step: int) -> Picture:
        config = self.config
        return self._painter.draw(
            tuple((self.model.params | {"opacities": opacities}).values()),
            turn.view,
            Settings(
                sh_degree=self._sh_degree_at(step),
                background=self.sight.behind(turn.background, turn.gain),
                antialias=config.antialias,
                outputs=OUT_INVERSE_DEPTH if turn.depth_terms else 0,
                threads=config.threads,
                disable=self._disable,
                tiles=None if Skip.MASKED_TILE in config.without else turn.sized.tiles,
            ),
        )

    def _compare(self, turn: _Turn, picture: Picture) -> _Loss:
        """Compare a picture with its photo; the gradient in it goes to `_v_rgb`."""
        _, image, mask, _, counted = turn.sized
        if self._v_rgb.shape != picture.rgb.shape:
            self._v_rgb = empty(*picture.rgb.shape)
        found = image_loss_gradient(
            picture.rgb,
            torch.from_numpy(image),
            self._v_rgb,
            ssim_weight=self.config.ssim_weight,
            mask=None if mask is None else torch.from_numpy(mask),
            mask_mode="none" if mask is None else self.photos.mask_mode,
            background=turn.background,
            threads=self.config.threads,
            gain=turn.gain,
        )
        more, v_alpha, v_inverse_depth = self._further_terms(turn, picture)
        return _Loss(
            value=found.loss + more,
            mse=mse_of_counted(found.mse, counted),
            v_log_gain=found.v_log_gain,
            v_alpha=v_alpha,
            v_inverse_depth=v_inverse_depth,
        )

    def _of_all(self, turn: _Turn, loss: _Loss) -> tuple[list[float], list[float]]:
        """Losses and mean squared errors of all photos of a batch.

        Raises:
            DatasetError: another rank's photo cannot be had; nothing was done.
        """
        if self.team is None or self._batch is None:
            return [loss.value], [loss.mse]
        count = len(turn.indices)
        sizes = self._batch.sizes(self._painter.radii, count)
        try:
            found = losses.of_all(
                self.team,
                loss.value,
                loss.mse,
                cost=self._painter.stats()["entries"],
                photos=count,
                mark=self._mark,
                sizes=sizes,
            )
        except DatasetError:
            self.sampler.put_back(count)
            self._collect_now()
            raise
        self._batch.hear(found.sizes)
        self._costs.update(zip(turn.indices, found.costs, strict=True))
        return found.values, found.errors

    def _gradients(
        self,
        turn: _Turn,
        picture: Picture,
        loss: _Loss,
        opacities: torch.Tensor,
        leaf: torch.Tensor | None,
    ) -> torch.Tensor:
        """Fill the model's gradients, and let gains and poses learn of theirs; returns those in
        the splats' places in the picture."""
        moves = self.learnt.pose_rate(self.steps / self.plan.iterations) > 0
        v_means2d = self._painter.gradients(
            self._batch.into(self.model, len(turn.indices)) if self._batch else self.model.grads,
            self._v_rgb,
            loss.v_alpha,
            loss.v_inverse_depth,
            viewmat=self._v_viewmat if moves else None,
        )
        if leaf is not None:
            grad = self.model.grads["opacities"]
            grad.copy_(torch.autograd.grad(opacities, leaf, grad)[0])
        self.laps.lap("gradients")
        v_log_gain = loss.v_log_gain
        if turn.gain is not None and self.photos.mask_mode == "composite":
            v_log_gain = without_background(
                v_log_gain, turn.background, turn.gain, self._v_rgb, picture.alpha
            )
        self._learn_of_photos(turn.indices, v_log_gain)
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
        settled = self.model.settled(threads=self.config.threads)
        return self._whole(self._in_world({name: p.clone() for name, p in settled.items()}))

    def parts(self) -> Iterator[Splats]:
        """What `splats` gives, some rows at a time, which are only good until the next step."""
        if self.still is not None:
            yield from self.still.parts(_ROWS_A_PART, self.model.sh_degree)
        for at in range(0, len(self.model), _ROWS_A_PART):
            rows = slice(at, at + _ROWS_A_PART)
            yield self._in_world(self.model.settled_rows(rows, threads=self.config.threads))

    def make_room(self) -> None:
        """Give back what the rasterizer keeps from step to step, before something else takes
        memory."""
        self._painter.release()

    def finish(self) -> Splats:
        """What `splats` gives, when no step will follow: without a copy, and the memory that only
        steps need is given back. Views can still be drawn."""
        self.make_room()
        self.model.settle(threads=self.config.threads)
        self.model.drop_moments()
        return self._whole(self._in_world(self.model.params))

    def release(self) -> None:
        """Give back what `restore` will replace; until then nothing else may be asked for."""
        self.make_room()
        self.model.drop_moments()

    def state(self) -> dict[str, Any]:
        """What is not a tensor, as JSON values."""
        return {
            "steps": self.steps,
            "iterations": self.plan.iterations,
            "frame": self.frame.to_dict(),
            "order": self.sampler.order,
            "position": self.sampler.position,
            "costs": sorted(self._costs.items()),
            "adam_steps": {name: self.model.steps(name) for name in self.model.params},
            "bad_rows": self.bad_rows,
            "lost_rows": self.lost_rows,
            "known": self._known,
            "skipped": self._skipped,
            "factor": self._factor if math.isfinite(self._factor) else None,
        } | self.removal.state()

    def collect(self) -> None:
        """Bring what other ranks know alone to rank 0, which calls for it."""
        if self._batch and not self._batch.complete:
            assert self.team is not None
            self.team.say(orders.collect())
            self._batch.collect(self.model)

    def _collect_now(self) -> None:
        """As `collect`, where all ranks are about to end for the same error."""
        if self._batch and not self._batch.complete:
            self._batch.collect(self.model)

    def tensors(self) -> dict[str, torch.Tensor]:
        """All tensors that the next step depends on, by name; no copies. Of a team, those of this
        rank; after `collect` rank 0 has all."""
        out = {"generator": self.generator.get_state()}
        for name, p in self.model.params.items():
            moment1, moment2 = self.model.moments(name)
            out |= {f"param/{name}": p, f"m1/{name}": moment1, f"m2/{name}": moment2}
        out |= {"gathered/shN": self.model.grads["shN"], "drift": self.model.drift}
        out |= self._batch.tensors() if self._batch else {}
        out |= self.learnt.tensors()
        return out | {f"row/{name}": counter for name, counter in self.model.rows.items()}

    def _drops(self) -> tuple[float, str]:
        return drop_rate_of(
            self.config,
            known=self._known,
            mask_mode=self.photos.mask_mode,
        )

    def restore(self, state: dict[str, Any], tensors: dict[str, torch.Tensor]) -> None:
        """Go on from what `state` and `tensors` of another trainer with this config returned; the
        tensors are taken over. Rank 0 hands both to all others of its team.

        The length of the run is that of the config, unless a time budget leaves it open.

        Raises:
            ValueError, KeyError: they are not what those return.
        """
        check_tensors(tensors, self.model)
        if self.team and self.team.leads:
            self.team.say(orders.restore(state))
            self.team.share(tensors)
        length = self.config.iterations
        if self.config.time_budget:
            length = whole("iterations", state.get("iterations", length), low=1)
        # What was found of the photos then: a run that stereo gave no points does not ask it again.
        if state.get("known") is not None:
            self._known = real("known", state["known"], low=0)
            self.drop_rate, self.drop_words = self._drops()
        self.replan(length)
        factor = state.get("factor")
        self._factor = math.inf if factor is None else real("factor", factor, low=1)
        names = list(self.model.params)
        rank, size = (self.team.rank, self.team.size) if self.team else (0, 1)
        gathered = gathered_of(tensors, rank, size)
        moments = {
            name: Moments(
                tensors[f"m1/{name}"],
                tensors[f"m2/{name}"],
                whole(f"adam_steps of {name}", state["adam_steps"][name]),
                gathered if name == "shN" else None,
            )
            for name in names
        }
        if self._batch:
            self._batch.forget()
        self._painter.release()
        self.sight.model = Model({name: tensors[f"param/{name}"] for name in names}, moments)
        rows = {key.removeprefix("row/"): t for key, t in tensors.items() if key[:4] == "row/"}
        self.model.rows = rows
        self.model.drift = tensors["drift"]
        self.learnt.restore(self.sampler.indices, len(self.photos.scene.cameras), tensors)
        self.generator.set_state(tensors["generator"])
        self.sampler.order = choices("order", state["order"], set(self.sampler.indices))
        self._costs = dict(measurements("costs", state.get("costs", [])))
        self.sampler.position = whole("position", state["position"], high=len(state["order"]))
        self.steps = whole("steps", state["steps"])
        self.bad_rows = whole("bad_rows", state["bad_rows"])
        self.lost_rows = whole("lost_rows", state.get("lost_rows", 0))
        self._skipped = whole("skipped", state["skipped"])
        self.removal.restore(state)

    def _first_splats(
        self, start: Splats | None, cloud: PointCloud, count: int, cameras: Cameras
    ) -> tuple[Splats, FreeSpace]:
        """What to begin with in the training world, and the space that stays empty there; both look
        at the same neighbours of points, which take more memory than a model where points are
        many."""
        config = self.config
        cloud = replace(cloud, points=self.frame.similarity.points_to_training(cloud.points))
        near = Nearest(cloud.points, asked=count)
        free_space = FreeSpace(
            cameras.centers[list(self.photos.train)],
            None if cloud.made_up else near,
            share=config.free_space,
        )
        if start is not None:
            return splats_to_go_on_with(start, config, self.frame), free_space
        if (sky := sky_splats(config, self.photos, cameras, cloud.points)) is None:
            return splats_of_cloud(cloud, near, config, self.plan, self.frame), free_space
        rest = replace(config, max_splats=config.max_splats - len(sky))
        first = splats_of_cloud(cloud, near, rest, self.plan, self.frame)
        return joined([first, sky]), free_space

    def _whole(self, trained: Splats) -> Splats:
        """`trained` splats after those that stand still, COLMAP world."""
        if self.still is None:
            return trained
        return joined([self.still.world, trained])

    def _in_world(self, params: dict[str, torch.Tensor]) -> Splats:
        return self.frame.similarity.splats_from_training(splats_of_tensors(params))

    def _widen_to(self, degree: int) -> None:
        if self.model.sh_degree < degree:
            self._painter.release()
            ops.widen_sh(self.model, degree)
            if self._batch:
                self._batch.forget()

    def _learn_of_photos(
        self, indices: Sequence[int], v_log_gain: tuple[float, float, float]
    ) -> None:
        """Let gains and poses take their steps; the derivatives are those of this rank's photo."""
        done = self.steps / self.plan.iterations
        if self.learnt.gains is None and not self.learnt.pose_rate(done):
            return
        mine = [*v_log_gain, *self._v_viewmat.flatten().tolist()]
        slopes = self.team.numbers(mine) if self.team else np.array([mine])
        self.learnt.learn(indices, slopes, done=done, factor=self.rate_factor)

    def _step_opacities(self, step: int) -> tuple[torch.Tensor, torch.Tensor | None]:
        """The opacities that this step draws, and, where they are not the model's own, the leaf
        that their gradients belong to."""
        opacities = self.model.params["opacities"]
        rate = drop_rate_at(self.drop_rate, step, self.plan.iterations)
        if rate <= 0:
            return opacities, None
        leaf = opacities.detach().requires_grad_()
        return drop_splats(leaf, rate, self.generator), leaf

    def _sh_degree_at(self, step: int) -> int:
        """The degree in use; that of given splats from the start."""
        return max(self.plan.sh_degree_at(step), self._given_degree)

    def _rates_at(self, step: int, count: int) -> dict[str, float]:
        """Learning rates but that of positions, of a step that takes `count` photos at once: their
        root (Zhao et al. 2024, Grendel-GS). The rate of the higher SH coefficients, which take
        `shN_every` photos at once anyway, is that of as many."""
        factors = dict.fromkeys(self.plan.rates, math.sqrt(count))
        factors["shN"] = math.sqrt(max(count / self.plan.shN_every, 1.0))
        rates = self.plan.rates_at(step)
        return {name: self.rate_factor * rate * factors[name] for name, rate in rates.items()}

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

    def _upcoming(self) -> list[int]:
        """Views that this rank will need, as far as they are drawn already."""
        if self.team is None:
            return self.sampler.upcoming(AHEAD)
        size = self.team.size
        return self.sampler.upcoming(AHEAD * size)[self.team.rank :: size]

    @property
    def _mark(self) -> float:
        """A number of the splats, where a team compares them: as often as they are held."""
        return float(crc_of(self.model.params)) if self.steps % _HOLD_EVERY == 0 else 0.0

    def _training_views(self) -> Iterator[Sized]:
        """All training views at the size of the last step."""
        indices = self.sampler.indices
        for i, index in enumerate(indices):
            yield self.sight.sized(index, self._factor, upcoming=indices[i + 1 :])

    def _step_background(self) -> tuple[float, float, float]:
        mode = self.config.background
        if mode is Background.AUTO:
            composite = self.photos.mask_mode == "composite"
            mode = Background.RANDOM if composite else Background.BLACK
        if mode is Background.RANDOM:
            r, g, b = uniform(3, self.generator).tolist()
            return (r, g, b)
        return COLORS[mode]

    def _further_terms(
        self, turn: _Turn, picture: Picture
    ) -> tuple[float, torch.Tensor | None, torch.Tensor | None]:
        """What depth, guides, masks and holes add to the loss of a view, and its gradients in the
        picture's opacity and inverse depth; None: it does not depend on them."""
        mask = turn.sized.mask
        value, v_alpha, v_inverse_depth = 0.0, None, None
        if turn.depth_terms and picture.inverse_depth is not None:
            inverse_depth = picture.inverse_depth.detach().requires_grad_()
            alpha = picture.alpha.detach().requires_grad_()
            parts = [w * loss(turn.index, inverse_depth, alpha) for w, loss in turn.depth_terms]
            term = sum(parts[1:], start=parts[0])
            value += term.item()
            v_inverse_depth, v_alpha = _slopes(term, inverse_depth, alpha)
        if self.config.alpha_weight and mask is not None and self.photos.mask_mode == "composite":
            alpha = picture.alpha.detach().requires_grad_()
            term = self.config.alpha_weight * opacity_loss(alpha, torch.from_numpy(mask))
            value += term.item()
            (more,) = _slopes(term, alpha)
            v_alpha = more if v_alpha is None or more is None else v_alpha + more
        if self.config.opaque_weight and self.photos.mask_mode != "composite":
            through, slope = see_through(picture.alpha.detach(), mask)
            value += self.config.opaque_weight * through
            slope *= self.config.opaque_weight
            v_alpha = slope if v_alpha is None else v_alpha + slope
        return value, v_alpha, v_inverse_depth

    def _assert_finite(self, turn: _Turn, value: float) -> None:
        if self.config.detect_anomaly:
            name = self.photos.scene.cameras.names[turn.index]
            guard.assert_finite(self.model, value, step=self.steps, view=name)

    def _skip(self, value: float, mse: float, lost_rows: int) -> StepResult:
        self._skipped += 1
        if self._skipped >= _MAX_SKIPPED:
            raise GsError(
                f"Training diverged: the loss was not finite for "
                f"{count_words(_MAX_SKIPPED, 'step')} in a row, "
                f"the last one step {self.steps}. Lower the learning rates; --detect-anomaly says "
                "where it begins."
            )
        return StepResult(value, mse, Change(), 0, True, lost_rows)

    def _hold(self) -> int:
        lost = bounds.hold(self.model, extent=self.frame.extent)
        self.lost_rows += lost
        return lost

    def _learn(
        self, step: int, v_means2d: torch.Tensor, view: Frustum, count: int
    ) -> tuple[Change, int]:
        """Step with the model's gradients; what changed, and how many rows were left out."""
        model, radii = self.model, self._painter.radii
        counters = self._batch.counters(model) if self._batch else model.rows
        drawn = DrawnView(
            step=step, radii=radii, v_means2d=v_means2d, width=view.width, height=view.height
        )
        self.strategy.observe(counters, drawn)
        if self._batch:
            radii = self._batch.add_up(
                model, counters=counters, photos=count, threads=self.config.threads
            )
        self.strategy.shape_gradients(model)
        means_lr = self.rate_factor * self.plan.means_lr_at(step) * math.sqrt(count)
        model.set_rates(self._rates_at(step, count) | {"means": means_lr})
        shown = None if Skip.UNSEEN_SH in self.config.without else radii
        rest = self._rest_at(step, count)
        if self._batch:
            self._batch.add_up_rest(model, rest, threads=self.config.threads)
        bad_rows = model.step(shown, shN=rest, photos=count, threads=self.config.threads)
        if self.plan.refines_at(step):
            self._painter.release()
        removed = self.removal.clear(model, self.plan, step)
        removed += self.removal.unveil(model, self.plan, step)
        change = self.strategy.after_step(
            model,
            step=step,
            means_lr=means_lr,
            cap=self.plan.cap_for(self._factor) - self._standing,
            generator=self.generator,
        )
        if self.region is not None and self._given:
            self.region.keep_inside(model.params["means"])
        return replace(change, removed=change.removed + removed), bad_rows


def _slopes(term: torch.Tensor, *leaves: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
    """d term / d leaf; None where the term does not depend on it."""
    if not term.requires_grad:
        return (None,) * len(leaves)
    return torch.autograd.grad(term, leaves, allow_unused=True)
