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
from ..live.protocol import Wish
from ..raster.header import OUT_INVERSE_DEPTH
from ..raster.loss import image_loss, image_loss_gradient
from ..raster.memory import empty, zeros
from ..raster.painter import Painter, Picture
from ..raster.request import Frustum, Settings
from ..scene import PointCloud
from ..splats import Splats
from ..words import count_words
from .depth.loss import DepthLoss
from .depth.regularisers import drop_rate_at, drop_splats, opacity_loss
from .depth.targets import DepthTargets
from .host.laps import Laps
from .host.random import generator_of, uniform
from .photos.pyramid import AHEAD, Pyramid, Sized, view_of
from .photos.skips import raster_bits
from .photos.views import Photos, Sampler
from .ranks import gradients, losses, orders
from .ranks.agree import crc_of
from .ranks.team import Team
from .rows import bounds, guard
from .rows.frame import Frame
from .rows.model import Model, Moments, ShN
from .rows.near import Nearest
from .rows.params import splats_of_tensors, tensors_from_splats
from .rows.start import splats_of_cloud, splats_to_go_on_with
from .rows.stored import check_tensors, choices, real, whole
from .schedule.batches import photos_at_once
from .schedule.plan import Plan
from .strategy import Change, DrawnView, make_strategy, ops
from .strategy.contribution import Weights, least, most_in_a_view, mostly_hidden, weights_by_view
from .strategy.free_space import FreeSpace
from .views.adam import rate_at
from .views.alignment import aligned
from .views.gains import PhotoGains, behind, without_background
from .views.placing import Placing
from .views.poses import LIMIT as POSE_LIMIT
from .views.poses import PhotoPoses

_MAX_SKIPPED = 100
_ABSURD_MSE = 1e4
"""Pictures are 0 to 1; colours of 100 come from splats that ran away."""
_ALIGNED_SIDE = 400
"""Longer side of the picture by which a held-out camera is aligned, px."""
_CROWD = 0.2
"""Share of the splats in the free space around cameras from which on it is not free."""
_GLANCE = 8
"""Sides of photos are divided by this to see whether a view shows anything."""
_HOLD_EVERY = 100
"""Steps between two looks at the bounds of `bounds`."""
_ROWS_A_PART = 1 << 16
"""Splats that are looked at together where not all need be."""
_COLORS = {Background.BLACK: (0.0, 0.0, 0.0), Background.WHITE: (1.0, 1.0, 1.0)}


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
        gains: PhotoGains | None = None,
        placing: Placing | None = None,
        photo_cache: int | None = None,
        team: Team | None = None,
    ) -> None:
        """Start from `start` or from `points`, in COLMAP world, or from the points of the capture.

        `depth` holds what to supervise depth with; `gains` how photos were exposed, which is
        learnt, None: they are taken as they are; `placing` where training cameras stand, None:
        where the capture has them; `photo_cache` is how many bytes of photos may be kept, None:
        all; `team` are the processes that train together, each of which makes such a trainer.

        Raises:
            DatasetError: nothing to train on.
            ConfigError: `start` has more splats than the config allows.
        """
        if not photos.train:
            raise DatasetError(
                "The capture has no photos to train on: all views are held out for the test; "
                "hold out fewer."
            )
        self.config = config
        self.photos = photos
        self.team = team
        """Those with whom each step is taken together; None: this process trains alone."""
        self.frame = frame or Frame.of(photos.scene, near=config.near)
        cloud = photos.scene.points if points is None else points
        count = min(len(cloud), config.max_splats) if start is None else len(start)
        cameras = photos.scene.cameras
        self._plan_of = partial(
            Plan.of,
            extent=self.frame.extent,
            points=count,
            side=int(min(cameras.widths.min(), cameras.heights.min())),
            pixels=int((cameras.widths * cameras.heights)[list(photos.train)].mean()),
        )
        self._factor = math.inf
        self.depth: DepthLoss | None = None
        """The depth loss, where depth is supervised."""
        if depth is not None:
            self.depth = DepthLoss(config, depth, scale=self.frame.similarity.scale)
        self.gains = gains
        """How photos were exposed, where that is learnt."""
        self.poses: PhotoPoses | None = None
        """Where training cameras stand, unless all stay where the capture has them."""
        self.replan(config.iterations)
        self.generator = generator_of(config.seed)
        self.sampler = Sampler(photos.train)
        self.steps = 0
        """Steps taken."""
        self.bad_rows = 0
        """Gradient rows left out so far because they were not finite."""
        self.lost_rows = 0
        """Splats taken out so far because they ran away; see `bounds`."""
        self.cleared = 0
        """Splats taken out so far because they stood too close before a camera."""
        self.crowded = False
        """So many stood there at once that something must be there: no space is free."""
        self.rate_factor = 1.0
        """All learning rates are multiplied by this."""
        self._skipped = 0
        self._pruned = 0
        self._painter = Painter()
        self._v_rgb = empty(0)
        self._v_shN = empty(0)
        self.laps = Laps()
        """What the parts of the last step took."""
        self._cameras = self.frame.similarity.cameras_to_training(photos.scene.cameras)
        if placing is not None and placing.viewmats is not None:
            self.poses = self._poses_of(placing)
        self._v_viewmat = zeros(4, 4)
        self._pyramid = Pyramid(photos, self._cameras, near=self.frame.near, limit=photo_cache)
        cloud = replace(cloud, points=self.frame.similarity.points_to_training(cloud.points))
        near = Nearest(cloud.points, asked=count)
        self._free_space = FreeSpace(
            self._cameras.centers[list(photos.train)],
            None if cloud.made_up else near,
            share=config.free_space,
        )
        if start is None:
            first = splats_of_cloud(cloud, near, config, self.plan, self.frame)
        else:
            first = splats_to_go_on_with(start, config, self.frame)
        del cloud, near  # of no more use, and larger than the model where points are many
        self.model = Model(tensors_from_splats(first))
        self._disable = raster_bits(config.without)
        self._given_degree = first.sh_degree
        if Skip.SH_BANDS in config.without:
            ops.widen_sh(self.model, config.sh_degree)
        self.strategy.start(self.model)

    def plan_of(self, iterations: int) -> Plan:
        """The plan of a run of this length; costs next to nothing."""
        return self._plan_of(replace(self.config, iterations=iterations))

    def replan(self, iterations: int) -> None:
        """Change the length of the run: from the next step on all schedules are those of a run
        that is `iterations` steps long."""
        self.plan = self.plan_of(iterations)
        """When things happen."""
        self.strategy = make_strategy(self.config, self.plan, extent=self.frame.extent)
        if self.depth:
            self.depth.set_length(iterations)

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
        laps = self.laps = Laps()
        self._widen_to(self.plan.sh_degree_at(step))
        indices = [self.sampler.next(self.generator) for _ in range(count)]
        # A rank that has no view in a batch looks at another's and keeps what it finds to itself.
        place = min(self.team.rank, count - 1) if self.team else 0
        index = indices[place]
        # A run that becomes longer does not go back to smaller photos.
        self._factor = min(self._factor, self.plan.factor_at(step))
        try:
            view, image, mask, tiles, counted = self._sized(
                index, self._factor, upcoming=self._upcoming()
            )
        except GsError as error:  # nothing was done, so that a checkpoint can be gone on from
            self.sampler.put_back(count)
            if self.team:
                losses.fail(self.team, error)
            raise
        background = [self._step_background() for _ in range(count)][place]
        gain = None if self.gains is None else self.gains.of(index)
        depth_weight = self.depth.weight(index, step) if self.depth else 0.0
        laps.pixels = view.width * view.height
        laps.lap("photo")
        for other in indices:  # also for those of other ranks, whose rows are then the same
            self.model.settle_for(self._view(other, self._factor), threads=config.threads)
        laps.lap("settle")
        opacities, leaf = self._step_opacities(step)
        picture = self._painter.draw(
            tuple((model.params | {"opacities": opacities}).values()),
            view,
            Settings(
                sh_degree=self._sh_degree_at(step),
                background=self._behind(background, gain),
                antialias=config.antialias,
                outputs=OUT_INVERSE_DEPTH if depth_weight > 0 else 0,
                threads=config.threads,
                disable=self._disable,
                tiles=None if Skip.MASKED_TILE in config.without else tiles,
            ),
        )
        laps.lap("draw")
        if self._v_rgb.shape != picture.rgb.shape:
            self._v_rgb = empty(*picture.rgb.shape)
        loss = image_loss_gradient(
            picture.rgb,
            torch.from_numpy(image),
            self._v_rgb,
            ssim_weight=config.ssim_weight,
            mask=None if mask is None else torch.from_numpy(mask),
            mask_mode="none" if mask is None else self.photos.mask_mode,
            background=background,
            threads=config.threads,
            gain=gain,
        )
        value, mse = loss.loss, _of_counted(loss.mse, counted)
        more, v_alpha, v_inverse_depth = self._further_terms(index, picture, mask, depth_weight)
        value += more
        values, errors = [value], [mse]
        if self.team:
            try:
                values, errors = losses.of_all(self.team, value, mse, photos=count, mark=self._mark)
            except DatasetError:
                self.sampler.put_back(count)
                raise
        value, mse = sum(values) / count, sum(errors) / count
        self.steps = step
        laps.lap("loss")
        if config.detect_anomaly and not math.isfinite(value):
            guard.assert_finite(model, value, step=step, view=self._cameras.names[index])
        # What breaks a loss is often a splat that ran away; the next views do without it.
        sane = math.isfinite(value) and all(found < _ABSURD_MSE for found in errors)
        lost_rows = 0 if sane else self._hold()
        if lost_rows or not math.isfinite(value):
            return self._skip(value, mse, lost_rows)
        self._skipped = 0
        pose_rate = self._pose_rate_at(step)
        v_means2d = self._painter.gradients(
            self._into(),
            self._v_rgb,
            v_alpha,
            v_inverse_depth,
            viewmat=self._v_viewmat if pose_rate else None,
        )
        if leaf is not None:
            grad = model.grads["opacities"]
            grad.copy_(torch.autograd.grad(opacities, leaf, grad)[0])
        laps.lap("gradients")
        v_log_gain = loss.v_log_gain
        if gain is not None and self.photos.mask_mode == "composite":
            v_log_gain = without_background(
                v_log_gain, background, gain, self._v_rgb, picture.alpha
            )
        self._learn_of_photos(indices, v_log_gain, pose_rate)
        laps.raster = self._painter.stats()
        if config.detect_anomaly:
            guard.assert_finite(model, value, step=step, view=self._cameras.names[index])
        change, bad_rows = self._learn(step, v_means2d, view, count)
        self.bad_rows += bad_rows
        change = self._prune(change)
        laps.lap("learn")
        lost_rows = self._hold() if step % _HOLD_EVERY == 0 else 0
        return StepResult(value, mse, change, bad_rows, False, lost_rows)

    def shows_splats(self, index: int) -> bool:
        """Whether any splat is drawn in view `index`; looked at in an eighth of its size."""
        view = self._view(index)
        factor = min(_GLANCE, view.width, view.height)
        width, height = view.width // factor, view.height // factor
        K = view.K / view.K.new_tensor([[factor], [factor], [1]])
        small = replace(view, K=K, width=width, height=height)
        return bool((self._show(small).alpha > 0).any())

    def picture(self, index: int, *, background: tuple[float, float, float]) -> torch.Tensor:
        """The view `index` as the splats show it now, [H, W, 3] float32: exposed as its photo
        where that is learnt of it, else neutral."""
        return self._exposed(index, self._view(index), background).clone()

    def seen(self, request: Wish) -> torch.Tensor:
        """What somebody who watches wants to see, [height, width, 3] float32, good until the next
        picture; the training goes on as if nobody had looked."""
        viewmats = self.frame.similarity.viewmats_to_training(request.viewmat[None])
        size = request.width, request.height
        view = view_of(viewmats[0], request.K, *size, self.frame.near)
        shown = dict(self.model.settled(threads=self.config.threads))
        if request.scaling != 1:
            shown["scales"] = shown["scales"] + math.log(request.scaling)
        config, background = self.config, self.fixed_background
        settings = Settings(
            antialias=config.antialias, threads=config.threads, background=background
        )
        return self._painter.draw(tuple(shown.values()), view, settings).rgb

    def aligned_picture(
        self, index: int, *, background: tuple[float, float, float]
    ) -> torch.Tensor:
        """The view `index` from where it looks most like its photo; its camera stays."""
        config, full = self.config, self._view(index)
        factor = max(1.0, max(full.width, full.height) / _ALIGNED_SIDE)
        settings = Settings(
            antialias=config.antialias, threads=config.threads, background=background
        )
        pose = aligned(
            self.model.settled(threads=config.threads),
            self._sized(index, factor),
            settings,
            mask_mode=self.photos.mask_mode,
            unit=self.frame.extent,
        )
        return self._show(replace(full, viewmat=pose), background=background).rgb.clone()

    def error(self, views: int = 8) -> float:
        """Root of the mean squared error of the pixels that count, in some training views at the
        next step's resolution."""
        indices = self.sampler.indices
        chosen = indices[:: -(-len(indices) // views)]
        background, total = self.fixed_background, 0.0
        for index in chosen:
            view, image, mask, _, counted = self._sized(index, self.plan.factor_at(self.steps + 1))
            loss = image_loss(
                self._exposed(index, view, background),
                torch.from_numpy(image),
                mask=None if mask is None else torch.from_numpy(mask),
                mask_mode="none" if mask is None else self.photos.mask_mode,
                background=background,
                threads=self.config.threads,
            )
            total += _of_counted(loss.mse, counted)
        return math.sqrt(total / len(chosen))

    def inverse_depth(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        """Accumulated inverse depth of view `index`, [H, W] float32, 1/world unit, and opacity."""
        found = self._show(self._view(index), outputs=OUT_INVERSE_DEPTH)
        assert found.inverse_depth is not None
        scale = np.float32(self.frame.similarity.scale)
        return found.inverse_depth.numpy() * scale, found.alpha.numpy().copy()

    @property
    def fixed_background(self) -> tuple[float, float, float]:
        """Background for pictures that people and metrics look at."""
        return _COLORS.get(self.config.background, _COLORS[Background.BLACK])

    def splats(self) -> Splats:
        """The splats as they are now, in COLMAP world, with the SH degrees in use so far."""
        settled = self.model.settled(threads=self.config.threads)
        return self._in_world({name: p.clone() for name, p in settled.items()})

    def parts(self) -> Iterator[Splats]:
        """What `splats` gives, some rows at a time, which are only good until the next step."""
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
        return self._in_world(self.model.params)

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
            "adam_steps": {name: self.model.steps(name) for name in self.model.params},
            "bad_rows": self.bad_rows,
            "lost_rows": self.lost_rows,
            "cleared": self.cleared,
            "crowded": self.crowded,
            "skipped": self._skipped,
            "factor": self._factor if math.isfinite(self._factor) else None,
            "pruned": self._pruned,
        }

    def tensors(self) -> dict[str, torch.Tensor]:
        """All tensors that the next step depends on, by name; no copies."""
        out = {"generator": self.generator.get_state()}
        for name, p in self.model.params.items():
            moment1, moment2 = self.model.moments(name)
            out |= {f"param/{name}": p, f"m1/{name}": moment1, f"m2/{name}": moment2}
        out |= {"gathered/shN": self.model.grads["shN"], "drift": self.model.drift}
        for learnt in (self.gains, self.poses):
            if learnt is not None:
                out |= learnt.tensors()
        return out | {f"row/{name}": counter for name, counter in self.model.rows.items()}

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
        self.replan(length)
        factor = state.get("factor")
        self._factor = math.inf if factor is None else real("factor", factor, low=1)
        names = list(self.model.params)
        moments = {
            name: Moments(
                tensors[f"m1/{name}"],
                tensors[f"m2/{name}"],
                whole(f"adam_steps of {name}", state["adam_steps"][name]),
                tensors.get(f"gathered/{name}"),
            )
            for name in names
        }
        self._painter.release()
        self.model = Model({name: tensors[f"param/{name}"] for name in names}, moments)
        rows = {key.removeprefix("row/"): t for key, t in tensors.items() if key[:4] == "row/"}
        self.model.rows = rows
        self.model.drift = tensors["drift"]
        # A run that began without goes on without.
        train, views = self.sampler.indices, len(self._cameras)
        found = PhotoGains.are_in(tensors)
        self.gains = PhotoGains.restored(train, views, tensors) if found else None
        found = PhotoPoses.are_in(tensors)
        self.poses = PhotoPoses.restored(train, views, tensors) if found else None
        self.generator.set_state(tensors["generator"])
        self.sampler.order = choices("order", state["order"], set(self.sampler.indices))
        self.sampler.position = whole("position", state["position"], high=len(state["order"]))
        self.steps = whole("steps", state["steps"])
        self.bad_rows = whole("bad_rows", state["bad_rows"])
        self.lost_rows = whole("lost_rows", state.get("lost_rows", 0))
        self.cleared = whole("cleared", state.get("cleared", 0))
        self.crowded = state.get("crowded", False) is True
        self._skipped = whole("skipped", state["skipped"])
        self._pruned = whole("pruned", state["pruned"])

    def _in_world(self, params: dict[str, torch.Tensor]) -> Splats:
        return self.frame.similarity.splats_from_training(splats_of_tensors(params))

    def _widen_to(self, degree: int) -> None:
        if self.model.sh_degree < degree:
            self._painter.release()
            ops.widen_sh(self.model, degree)

    def _show(self, view: Frustum, **options: Any) -> Picture:
        """The whole view as the splats are now, good until the next one; `options` are those of
        `Settings`."""
        config = self.config
        settings = Settings(antialias=config.antialias, threads=config.threads, **options)
        splats = self.model.settled(threads=config.threads)
        return self._painter.draw(tuple(splats.values()), view, settings)

    def _poses_of(self, placing: Placing) -> PhotoPoses:
        assert placing.viewmats is not None
        cameras = replace(self.photos.scene.cameras, viewmats=placing.viewmats)
        return PhotoPoses(
            self.photos.train,
            self.frame.similarity.cameras_to_training(cameras).viewmats,
            unit=self.frame.extent,
            limit=POSE_LIMIT,
            learns=placing.learns,
        )

    def _view(self, index: int, factor: float = 1.0) -> Frustum:
        """View `index` with sides divided by `factor`, from where its camera stands."""
        view = self._pyramid.view(index, factor)
        return view if self.poses is None else replace(view, viewmat=self.poses.of(index))

    def _sized(self, index: int, factor: float, *, upcoming: Sequence[int] = ()) -> Sized:
        """View `index` with its photo, sides divided by `factor`, from where its camera stands."""
        found = self._pyramid.at(index, factor, upcoming=upcoming)
        if self.poses is None:
            return found
        return found._replace(view=replace(found.view, viewmat=self.poses.of(index)))

    def _pose_rate_at(self, step: int) -> float:
        """Learning rate of poses; 0: they stay."""
        if self.poses is None or not self.poses.learns:
            return 0.0
        config = self.config
        done = step / self.plan.iterations - config.pose_start
        span = config.pose_stop - config.pose_start
        if not 0 <= done < span:
            return 0.0
        return rate_at(config.pose_lr, config.pose_lr_final, done / span)

    def _exposed(
        self, index: int, view: Frustum, background: tuple[float, float, float]
    ) -> torch.Tensor:
        """The picture of `view`, that of photo `index` at any size, as the photo was exposed."""
        gain = None if self.gains is None else self.gains.of(index)
        picture = self._show(view, background=self._behind(background, gain)).rgb
        return picture if gain is None else picture.mul_(gain)

    def _behind(
        self, background: tuple[float, float, float], gain: torch.Tensor | None
    ) -> tuple[float, float, float]:
        """What splats are drawn over, so that `background` shows once the gain is applied: where
        photos are laid over it. Elsewhere it is part of the scene, exposed with it."""
        if gain is None or self.photos.mask_mode != "composite":
            return background
        return behind(background, gain)

    def _learn_of_photos(
        self, indices: Sequence[int], v_log_gain: tuple[float, float, float], pose_rate: float
    ) -> None:
        """Let gains and poses take their steps, photo by photo of the batch; the derivatives in
        them are those of this rank's photo."""
        poses = self.poses if pose_rate else None
        if poses is None and self.gains is None:
            return
        mine = [*v_log_gain, *self._v_viewmat.flatten().tolist()]
        found = self.team.numbers(mine) if self.team else np.array([mine])
        first, last = self.config.exposure_lr, self.config.exposure_lr_final
        gain_rate = rate_at(first, last, self.steps / self.plan.iterations)
        for index, numbers in zip(indices, found, strict=False):
            if poses is not None:
                v_viewmat = torch.from_numpy(numbers[3:].astype(np.float32).reshape(4, 4))
                poses.learn(index, v_viewmat, self.rate_factor * pose_rate)
            if self.gains is not None:
                self.gains.learn(index, numbers[:3].tolist(), self.rate_factor * gain_rate)

    def _step_opacities(self, step: int) -> tuple[torch.Tensor, torch.Tensor | None]:
        """The opacities that this step draws, and, where they are not the model's own, the leaf
        that their gradients belong to."""
        opacities = self.model.params["opacities"]
        rate = drop_rate_at(self.config.drop_rate, step, self.plan.iterations)
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

    def _into(self) -> dict[str, torch.Tensor]:
        """Where the gradients of this rank's photo go: a team adds them up before they are the
        model's, where those of shN have gathered."""
        if self.team is None:
            return self.model.grads
        shN = self.model.grads["shN"]
        if self._v_shN.shape != shN.shape:
            self._v_shN = empty(*shN.shape)
        return self.model.grads | {"shN": self._v_shN.zero_()}

    @property
    def _mark(self) -> float:
        """A number of the splats, where a team compares them: as often as they are held."""
        return float(crc_of(self.model.params)) if self.steps % _HOLD_EVERY == 0 else 0.0

    def _step_background(self) -> tuple[float, float, float]:
        mode = self.config.background
        if mode is Background.AUTO:
            composite = self.photos.mask_mode == "composite"
            mode = Background.RANDOM if composite else Background.BLACK
        if mode is Background.RANDOM:
            r, g, b = uniform(3, self.generator).tolist()
            return (r, g, b)
        return _COLORS[mode]

    def _further_terms(
        self, index: int, picture: Picture, mask: np.ndarray | None, depth_weight: float
    ) -> tuple[float, torch.Tensor | None, torch.Tensor | None]:
        """What depth and masks add to the loss of a view, and its gradients in the picture's
        opacity and inverse depth; None: it does not depend on them."""
        value, v_alpha, v_inverse_depth = 0.0, None, None
        if self.depth and picture.inverse_depth is not None:
            inverse_depth = picture.inverse_depth.detach().requires_grad_()
            alpha = picture.alpha.detach().requires_grad_()
            term = depth_weight * self.depth(index, inverse_depth, alpha)
            value += term.item()
            v_inverse_depth, v_alpha = _gradients(term, inverse_depth, alpha)
        if self.config.alpha_weight and mask is not None and self.photos.mask_mode == "composite":
            alpha = picture.alpha.detach().requires_grad_()
            term = self.config.alpha_weight * opacity_loss(alpha, torch.from_numpy(mask))
            value += term.item()
            (more,) = _gradients(term, alpha)
            v_alpha = more if v_alpha is None or more is None else v_alpha + more
        return value, v_alpha, v_inverse_depth

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
        counters = gradients.counters_of(model) if self.team else model.rows
        drawn = DrawnView(
            step=step, radii=radii, v_means2d=v_means2d, width=view.width, height=view.height
        )
        self.strategy.observe(counters, drawn)
        if self.team:
            radii = gradients.add_up(
                self.team, model, radii=radii, v_shN=self._v_shN, counters=counters, photos=count
            )
        self.strategy.shape_gradients(model)
        means_lr = self.rate_factor * self.plan.means_lr_at(step) * math.sqrt(count)
        model.set_rates(self._rates_at(step, count) | {"means": means_lr})
        shown = None if Skip.UNSEEN_SH in self.config.without else radii
        bad_rows = model.step(
            shown, shN=self._rest_at(step, count), photos=count, threads=self.config.threads
        )
        if self.plan.refines_at(step):
            self._painter.release()
        removed = self._clear(step) + self._unveil(step)
        change = self.strategy.after_step(
            model,
            step=step,
            means_lr=means_lr,
            cap=self.plan.cap_for(self._factor),
            generator=self.generator,
        )
        return replace(change, removed=change.removed + removed), bad_rows

    def _prune(self, change: Change) -> Change:
        """Take out what adds least to the photos, once there are to be fewer splats; `change` with
        those."""
        model = self.model
        count = self.plan.surplus_at(self.steps, len(model), self._pruned)
        if count == 0:
            return change
        weights = most_in_a_view(self._weights(), len(model))
        self._take_out(least(weights, count))
        self._pruned += count
        return replace(change, removed=change.removed + count)

    def _weights(self) -> Iterator[Weights]:
        """The splats' blending weights in each training view at the size of the last step."""
        indices = self.sampler.indices
        return weights_by_view(
            self._painter,
            self.model.params,
            (
                self._sized(index, self._factor, upcoming=indices[i + 1 :])
                for i, index in enumerate(indices)
            ),
            antialias=self.config.antialias,
            masks_hide=self.photos.mask_mode == "ignore",
            scratch=self.model.grads,  # they were for the step that is done
            threads=self.config.threads,
        )

    def _unveil(self, step: int) -> int:
        """Take out what stands where masks hide it; how many that were."""
        share = self.config.hidden_share
        if share == 0 or self.photos.mask_mode != "ignore" or not self.plan.unveils_at(step):
            return 0
        hidden = mostly_hidden(self._weights(), len(self.model), share=share)
        count = int(hidden.sum())
        if count == 0 or count == len(self.model):
            return 0
        self._take_out(hidden)
        return count

    def _clear(self, step: int) -> int:
        """Take out what stands in the free space around cameras; how many that were."""
        if self.crowded or not self.plan.clears_at(step):
            return 0
        inside = self._free_space.holds(self.model.params["means"])
        count = int(inside.sum())
        self.crowded = count > _CROWD * len(self.model)
        if count == 0 or self.crowded:
            return 0
        self._take_out(inside)
        self.cleared += count
        return count

    def _take_out(self, rows: torch.Tensor) -> None:
        """Edit the model so that it goes on without these splats, [N] bool; the rasterizer's memory
        makes room for that."""
        self._painter.release()
        ops.edit(self.model, keep=(~rows).nonzero().flatten())


def _of_counted(mse: float, counted: float) -> float:
    """The mean squared error of the pixels that count, where the others are equal; 0: none do."""
    return mse / counted if counted > 0 else 0.0


def _gradients(term: torch.Tensor, *leaves: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
    """d term / d leaf; None where the term does not depend on it."""
    if not term.requires_grad:
        return (None,) * len(leaves)
    return torch.autograd.grad(term, leaves, allow_unused=True)
