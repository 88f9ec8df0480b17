"""The training step and all state it depends on; no files, no events, no clock."""

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import torch

from ..config import Background, TrainConfig
from ..errors import ConfigError, DatasetError, GsError
from ..raster.autograd import RasterAux, rasterize
from ..raster.loss import image_loss
from ..splats import SH_REST_BY_DEGREE, Splats
from . import guard
from .frame import Frame
from .model import Model
from .params import splats_from_points, splats_from_tensors, tensors_from_splats
from .pyramid import Pyramid
from .schedules import Plan
from .strategy import Change, make_strategy, ops
from .views import Photos, Sampler, View

_MAX_SKIPPED = 100
_COLORS = {Background.BLACK: (0.0, 0.0, 0.0), Background.WHITE: (1.0, 1.0, 1.0)}


class StepResult(NamedTuple):
    """What a step measured and did."""

    loss: float
    mse: float
    """Mean squared error of the view before the step."""
    change: Change
    """What the strategy did."""
    bad_rows: int
    """Splats whose gradients were not finite and were left out."""
    skipped: bool
    """The loss was not finite, so nothing was learnt."""


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
    ) -> None:
        """Start from `start`, in COLMAP world, or from the points of the capture.

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
        self.frame = frame or Frame.of(photos.scene, near=config.near)
        points = min(len(photos.scene.points), config.max_splats) if start is None else len(start)
        cameras = photos.scene.cameras
        side = int(min(cameras.widths.min(), cameras.heights.min()))
        self.plan = Plan.of(config, extent=self.frame.extent, points=points, side=side)
        self.strategy = make_strategy(config, self.plan, extent=self.frame.extent)
        self.generator = torch.Generator().manual_seed(config.seed)
        self.sampler = Sampler(photos.train)
        self.steps = 0
        """Steps taken."""
        self.bad_rows = 0
        """Gradient rows left out so far because they were not finite."""
        self._skipped = 0
        self._cameras = self.frame.similarity.cameras_to_training(photos.scene.cameras)
        self._pyramid = Pyramid(photos, self._cameras)
        first = self._first_splats() if start is None else self._placed(start)
        self.model = Model(tensors_from_splats(first))
        self.strategy.start(self.model)

    def step(self) -> StepResult:
        """Render a view, compare it with the photo, improve the splats.

        Raises:
            GsError: the loss was not finite for many steps, or once under `detect_anomaly`.
        """
        step, config, model = self.steps + 1, self.config, self.model
        ops.widen_sh(model, self.plan.sh_degree_at(step))
        index = self.sampler.next(self.generator)
        view, image, mask = self._pyramid.at(index, self.plan.factor_at(step))
        background = self._step_background()
        aux = RasterAux()
        picture = rasterize(
            *model.arguments,
            view.viewmat,
            view.K,
            view.width,
            view.height,
            raw=True,
            background=background,
            near=self.frame.near,
            antialias=config.antialias,
            threads=config.threads,
            aux=aux,
        )
        loss = image_loss(
            picture.rgb,
            torch.from_numpy(image),
            ssim_weight=config.ssim_weight,
            mask=None if mask is None else torch.from_numpy(mask),
            mask_mode="none" if mask is None else self.photos.mask_mode,
            background=background,
            threads=config.threads,
        )
        value = loss.loss.item()
        self.steps = step
        loss.loss.backward()
        if config.detect_anomaly:
            guard.assert_finite(model, value, step=step, view=self._cameras.names[index])
        if not math.isfinite(value):
            return self._skip(value, loss.mse)
        self._skipped = 0
        bad_rows = guard.zero_bad_rows(model)
        self.bad_rows += bad_rows
        return StepResult(value, loss.mse, self._learn(step, aux, view), bad_rows, False)

    def picture(self, index: int, *, background: tuple[float, float, float]) -> torch.Tensor:
        """The view `index` as the splats show it now, [H, W, 3] float32."""
        view = self._pyramid.view(index)
        with torch.no_grad():
            return rasterize(
                *self.model.arguments,
                view.viewmat,
                view.K,
                view.width,
                view.height,
                raw=True,
                background=background,
                near=self.frame.near,
                antialias=self.config.antialias,
                threads=self.config.threads,
            ).rgb

    @property
    def fixed_background(self) -> tuple[float, float, float]:
        """Background for pictures that people and metrics look at."""
        return _COLORS.get(self.config.background, _COLORS[Background.BLACK])

    def splats(self) -> Splats:
        """The splats as they are now, in COLMAP world, with all SH coefficients of the config."""
        splats = splats_from_tensors(self.model.params, sh_degree=self.config.sh_degree)
        return self.frame.similarity.splats_from_training(splats)

    def state(self) -> dict[str, Any]:
        """What is not a tensor, as JSON values."""
        return {
            "steps": self.steps,
            "frame": self.frame.to_dict(),
            "order": self.sampler.order,
            "position": self.sampler.position,
            "adam_steps": {name: self.model.steps(name) for name in self.model.params},
            "bad_rows": self.bad_rows,
            "skipped": self._skipped,
        }

    def tensors(self) -> dict[str, torch.Tensor]:
        """All tensors that the next step depends on, by name; no copies."""
        out = {"generator": self.generator.get_state()}
        for name, p in self.model.params.items():
            moment1, moment2 = self.model.moments(name)
            out |= {f"param/{name}": p.detach(), f"m1/{name}": moment1, f"m2/{name}": moment2}
        return out | {f"row/{name}": counter for name, counter in self.model.rows.items()}

    def restore(self, state: dict[str, Any], tensors: dict[str, torch.Tensor]) -> None:
        """Go on from what `state` and `tensors` of another trainer with this config returned."""
        names = list(self.model.params)
        self.model = Model({name: tensors[f"param/{name}"] for name in names})
        for name in names:
            self.model.replace(
                name,
                self.model.params[name],
                tensors[f"m1/{name}"],
                tensors[f"m2/{name}"],
                steps=state["adam_steps"][name],
            )
        rows = {key.removeprefix("row/"): t for key, t in tensors.items() if key[:4] == "row/"}
        self.model.rows = rows
        self.generator.set_state(tensors["generator"])
        self.sampler.order, self.sampler.position = list(state["order"]), state["position"]
        self.steps, self.bad_rows = state["steps"], state["bad_rows"]
        self._skipped = state["skipped"]

    def _first_splats(self) -> Splats:
        cloud = self.photos.scene.points
        points = self.frame.similarity.points_to_training(cloud.points)
        return splats_from_points(
            type(cloud)(points=points, colors=cloud.colors),
            extent=self.frame.extent,
            opacity=self.plan.init_opacity,
            scale=self.plan.init_scale,
            max_splats=self.config.max_splats,
            seed=self.config.seed,
        )

    def _placed(self, start: Splats) -> Splats:
        """Given splats in the training world, with no higher SH degree than the config has."""
        if not 0 < len(start) <= self.config.max_splats:
            raise ConfigError(
                f"The splats to start from are {len(start)}, expected 1 to max_splats = "
                f"{self.config.max_splats}; raise --max-splats or start from fewer."
            )
        rest = SH_REST_BY_DEGREE[self.config.sh_degree]
        start = replace(start, shN=np.ascontiguousarray(start.shN[:, :rest]))
        return self.frame.similarity.splats_to_training(start)

    def _step_background(self) -> tuple[float, float, float]:
        mode = self.config.background
        if mode is Background.AUTO:
            composite = self.photos.mask_mode == "composite"
            mode = Background.RANDOM if composite else Background.BLACK
        if mode is Background.RANDOM:
            r, g, b = torch.rand(3, generator=self.generator).tolist()
            return (r, g, b)
        return _COLORS[mode]

    def _skip(self, value: float, mse: float) -> StepResult:
        self.model.drop_gradients()
        self._skipped += 1
        if self._skipped >= _MAX_SKIPPED:
            raise GsError(
                f"Training diverged: the loss was not finite for {_MAX_SKIPPED} steps in a row, "
                f"the last one step {self.steps}. Lower the learning rates; --detect-anomaly says "
                "where it begins."
            )
        return StepResult(value, mse, Change(), 0, True)

    def _learn(self, step: int, aux: RasterAux, view: View) -> Change:
        model = self.model
        if aux.radii is None or aux.v_means2d is None:
            raise GsError("The rasterizer returned no radii; reinstall gscore.")
        self.strategy.shape_gradients(model)
        self.strategy.observe(
            model,
            step=step,
            radii=aux.radii,
            v_means2d=aux.v_means2d,
            width=view.width,
            height=view.height,
        )
        means_lr = self.plan.means_lr_at(step)
        model.set_rates(self.plan.rates | {"means": means_lr})
        model.step()
        return self.strategy.after_step(
            model, step=step, means_lr=means_lr, generator=self.generator
        )
