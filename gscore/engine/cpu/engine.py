"""CPU engine: training steps and pictures by the native library."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch

from ...choices import Skip
from ...errors import GsError
from ...raster import native_library
from ...raster.header import (
    NO_EXACT_CULL,
    NO_OPACITY_EXTENT,
    NO_ROW_RANGE,
    NO_ZERO_TILE,
    OUT_INVERSE_DEPTH,
)
from ...raster.memory import ones, zeros
from ...raster.random_numbers import normal_rows, uniform_rows
from ...raster.request import Frustum, Settings
from ...raster.screen_gradients import add_screen_gradients
from ...raster.training_rasterizer import TrainingRasterizer
from ...shared_constants import DROPOUT_ROWS
from ...splats import PARAMETERS
from ...text_format import count_text
from .. import base
from ..base import ABSURD_MSE, Color, Columns, Contribution, StepNumbers, StepPhoto, StepRequest
from ..ensemble import merge_models
from ..stage_timer import StageTimer
from .loss import LossAndGradients, StepLoss
from .model import CpuModel, Moments, accumulated_of
from .pace import COST, current_pace
from .splat_terms import add_noise, add_regularisers, drop_splats, dropout_blocks
from .surface_term import surface_terms

_SKIPS = {
    Skip.EXACT_CULL: NO_EXACT_CULL,
    Skip.OPACITY_EXTENT: NO_OPACITY_EXTENT,
    Skip.ROW_RANGE: NO_ROW_RANGE,
    Skip.ZERO_TILE: NO_ZERO_TILE,
}
"""Bits of the rasterizer that disable them."""


@dataclass
class DrawnStep:
    """A step between its loss and its update."""

    loss: LossAndGradients
    opacities: torch.Tensor
    leaf: torch.Tensor | None
    """Opacities before dropout; None: no dropout."""
    further: Mapping[str, torch.Tensor]
    """Gradients of terms that have their own picture; those of shN excepted."""
    timer: StageTimer


class CpuEngine(base.Engine[CpuModel]):
    """Engine that computes on the CPU, in one workspace; a step is done when it returns."""

    def __init__(self, *, threads: int = 0) -> None:
        """`threads`: 0: all cores; results do not depend on it."""
        self._threads = threads
        self.info = base.EngineInfo(
            name="cpu",
            numerics=native_library.isa(),
            threads=threads or native_library.default_threads(),
            features=frozenset(base.Feature),
            skips=base.ENGINE_SKIPS,
            cost=COST,
        )
        """Identity and capabilities."""
        self._rasterizer = TrainingRasterizer()
        self._frozen: Mapping[str, torch.Tensor] | None = None
        """Splats that are drawn with those of the model; None: none."""
        self._loss = StepLoss(threads)
        self._photos: dict[int, StepPhoto] = {}
        self._v_viewmat = zeros(4, 4)
        self._scratch: dict[str, torch.Tensor] = {}
        """Gradients of the splats in `pose_gradient`, which are not used; kept between steps."""
        self._merged: tuple[list[Mapping[str, torch.Tensor]], dict[str, torch.Tensor]] | None = None
        """Parameters of the models that were merged last, and of their merged model."""

    def pace(self) -> float:
        """Measure the pace, see `Engine.pace`."""
        return current_pace(self._threads)

    def model(
        self, columns: Columns, *, counters: Sequence[str] = (), frozen: Columns | None = None
    ) -> CpuModel:
        """Create a model, see `Engine.model`."""
        if frozen is not None:
            self._frozen = {name: torch.from_numpy(frozen[name]) for name in PARAMETERS}
            self._rasterizer = TrainingRasterizer(self._frozen)
        return self._new({name: torch.from_numpy(columns[name]) for name in PARAMETERS}, counters)

    def load(
        self, saved: Columns, adam_steps: Mapping[str, int], like: CpuModel | None = None
    ) -> CpuModel:
        """Create a model from `EngineModel.save`, see `Engine.load`; `like` is not used."""
        tensors = {name: torch.from_numpy(column) for name, column in saved.items()}
        moments = {
            name: Moments(
                tensors[f"m1/{name}"],
                tensors[f"m2/{name}"],
                adam_steps[name],
                self._accumulated(tensors) if name == "shN" else None,
            )
            for name in PARAMETERS
        }
        model = self._new({name: tensors[f"param/{name}"] for name in PARAMETERS}, (), moments)
        model.rows = base.counters_of(tensors)
        model.factors = tensors["drift"]
        return model

    def _accumulated(self, saved: Mapping[str, torch.Tensor]) -> torch.Tensor | None:
        """Accumulated shN gradient of a saved model."""
        return accumulated_of(saved, 0, 1)

    def _new(
        self,
        tensors: Mapping[str, torch.Tensor],
        counters: Sequence[str],
        moments: Mapping[str, Moments] | None = None,
    ) -> CpuModel:
        return CpuModel(tensors, moments, counters=counters, threads=self._threads)

    def put(self, key: int, photo: StepPhoto) -> None:
        """Provide a photo for the next step that names it."""
        self._photos[key] = photo

    def step(self, model: CpuModel, request: StepRequest) -> base.Pending:
        """Take a step, see `StepRequest`."""
        drawn = self._draw_step(model, request)
        loss = drawn.loss
        lost_rows, skipped = self._checked(model, request, drawn, [(loss.value, loss.mse)])
        numbers = StepNumbers(
            step=request.step,
            loss=loss.value,
            mse=loss.mse,
            lost_rows=lost_rows,
            skipped=skipped,
            seconds=drawn.timer.seconds,
        )
        if skipped:
            return numbers
        v_means2d = self._backward(request, drawn, model.grads)
        slopes = np.array([self._slopes_of(request, loss)])
        self._observe(request, model.rows, v_means2d)
        bad_rows = self._update(model, request, self._rasterizer.radii)
        drawn.timer.lap("learn")
        return numbers._replace(slopes=slopes, bad_rows=bad_rows, raster=drawn.timer.raster)

    def _draw_step(self, model: CpuModel, request: StepRequest) -> DrawnStep:
        """Draw the view of a step and compute its loss."""
        timer, photo = StageTimer(), self._photos.pop(request.photo)
        self._merged, self._scratch = None, {}
        for view in (request.view, *request.others):
            model.sync_visible(view)
        timer.lap("settle")
        opacities, leaf = model.params["opacities"], None
        if request.drop_rate > 0:
            leaf = opacities.detach().requires_grad_()
            block = dropout_blocks(len(leaf), request.step)
            random = self._random(request, base.DROPOUT_STREAM)
            numbers = uniform_rows(len(leaf) // DROPOUT_ROWS + 2, **random)
            opacities = drop_splats(leaf, request.drop_rate, numbers[block])
        picture = self._rasterizer.draw(
            tuple((model.params | {"opacities": opacities}).values()),
            request.view,
            self._settings(
                request.background,
                request.antialias,
                sh_degree=request.sh_degree,
                inverse_depth=request.picture_term is not None,
                disable=sum(_SKIPS[skip] for skip in request.disable),
                tiles=request.tiles_of(photo),
            ),
        )
        timer.lap("draw")
        loss, further = self._loss.of(picture, photo, request), {}
        if request.surface:
            value, further = surface_terms(
                model.params,
                photo,
                request.view,
                request.surface,
                frozen=self._frozen,
                antialias=request.antialias,
                threads=self._threads,
            )
            loss = loss._replace(value=loss.value + value)
        return DrawnStep(loss, opacities, leaf, further, timer)

    def _checked(
        self,
        model: CpuModel,
        request: StepRequest,
        drawn: DrawnStep,
        losses: Sequence[tuple[float, float]],
    ) -> tuple[int, bool]:
        """Check the losses and mean squared errors of the photos of a step; returns the number of
        rows that were reset, and whether the step is skipped."""
        drawn.timer.lap("loss")
        value = sum(value for value, _ in losses) / len(losses)
        self._assert_finite(model, request, value)
        # A loss that is not finite often comes from one runaway splat; reset it immediately.
        sane = math.isfinite(value) and all(mse < ABSURD_MSE for _, mse in losses)
        lost_rows = 0 if sane else model.clamp_runaways(request.extent)
        return lost_rows, lost_rows > 0 or not math.isfinite(value)

    def _backward(
        self, request: StepRequest, drawn: DrawnStep, into: Mapping[str, torch.Tensor]
    ) -> torch.Tensor:
        """Write the gradients of a step into `into`; returns those of the projected means."""
        loss = drawn.loss
        v_means2d = self._rasterizer.gradients(
            into,
            loss.v_rgb,
            loss.v_alpha,
            loss.v_inverse_depth,
            viewmat=self._v_viewmat if request.learn_pose else None,
        )
        if drawn.leaf is not None:
            grad = into["opacities"]
            grad.copy_(torch.autograd.grad(drawn.opacities, drawn.leaf, grad)[0])
        hidden = self._rasterizer.radii == 0
        for name, more in drawn.further.items():
            more[hidden] = 0  # in its smaller picture a splat may be larger
            into[name].add_(more)
        drawn.timer.lap("gradients")
        drawn.timer.add_raster(self._rasterizer.stats())
        return v_means2d

    def _slopes_of(self, request: StepRequest, loss: LossAndGradients) -> list[float]:
        """Derivatives of the loss in the gain and pose of this engine's photo."""
        pose = self._v_viewmat.flatten().tolist() if request.learn_pose else [0.0] * 16
        return [*loss.v_log_gain, *pose]

    def _observe(
        self, request: StepRequest, rows: Mapping[str, torch.Tensor], v_means2d: torch.Tensor
    ) -> None:
        """Count screen-space gradients."""
        if not request.observe:
            return
        sums, views = (rows[name] for name in request.observe)
        scale = 0.5 * request.view.width, 0.5 * request.view.height
        radii = self._rasterizer.radii
        add_screen_gradients(sums, views, v_means2d, radii, scale, threads=self._threads)

    def _update(self, model: CpuModel, request: StepRequest, radii: torch.Tensor) -> int:
        """Add regularisers, take an Adam step and add noise; returns the number of bad rows.

        `radii`: above 0 for splats that receive a step.
        """
        self._assert_finite(model, request, 0.0)
        add_regularisers(model, opacity_reg=request.opacity_reg, scale_reg=request.scale_reg)
        model.set_rates(request.rates)
        shown = None if request.update_hidden else radii
        bad_rows = model.step(shown, shN=request.sh_update, photos=1 + len(request.others))
        if request.noise > 0:
            normal = partial(normal_rows, **self._random(request, base.NOISE_STREAM))
            add_noise(model, request.noise, normal)
        return bad_rows

    def _random(self, request: StepRequest, stream: int) -> dict[str, int]:
        """Arguments that select the random numbers of a step."""
        stream += base.STREAMS * request.place
        step = request.step
        return {"seed": request.seed, "step": step, "stream": stream, "threads": self._threads}

    def _assert_finite(self, model: CpuModel, request: StepRequest, value: float) -> None:
        if request.check_finite:
            assert_finite(model, value, step=request.step, view=request.check_finite)

    def draw(
        self,
        models: Sequence[CpuModel],
        view: Frustum,
        *,
        background: Color,
        antialias: bool,
        inverse_depth: bool = False,
        scaling: float = 1.0,
    ) -> base.DrawnPicture:
        """Draw the current models, see `Engine.draw`."""
        splats = dict(self._splats(models))
        if scaling != 1:
            splats["scales"] = splats["scales"] + math.log(scaling)
        settings = self._settings(background, antialias, inverse_depth=inverse_depth)
        drawn = self._rasterizer.draw(tuple(splats.values()), view, settings)
        depth = None if drawn.inverse_depth is None else drawn.inverse_depth.numpy()
        return base.DrawnPicture(drawn.rgb.numpy(), drawn.alpha.numpy(), depth)

    def contributions(
        self, model: CpuModel, views: Iterable[tuple[Frustum, StepPhoto]], *, antialias: bool
    ) -> Iterator[Contribution]:
        """Yield the contributions of the splats to each view; overwrites the gradients that do not
        accumulate."""
        settings = self._settings((0.0, 0.0, 0.0), antialias)
        for view, photo in views:
            counts = ones(view.height, view.width, 3)
            if photo.mask_mode == "ignore" and photo.mask is not None:
                counts[..., 0] = torch.from_numpy(photo.mask).to(counts.dtype) / 255
            sums = self._rasterizer.weights(model.params, view, settings, counts, model.grads)
            yield Contribution(sums[:, 0].copy(), sums[:, 1].copy())

    def pose_gradient(
        self,
        models: Sequence[CpuModel],
        view: Frustum,
        photo: StepPhoto,
        *,
        background: Color,
        antialias: bool,
    ) -> np.ndarray:
        """Return the gradient of a view's loss in its pose, see `Engine.pose_gradient`."""
        splats = self._splats(models)
        settings = self._settings(background, antialias)
        picture = self._rasterizer.draw(tuple(splats.values()), view, settings)
        _, v_rgb = self._loss.photometric(picture.rgb, photo, background=background)
        for name, t in splats.items():
            if name not in self._scratch or self._scratch[name].shape != t.shape:
                self._scratch[name] = zeros(*t.shape)
        self._rasterizer.gradients(self._scratch, v_rgb, viewmat=self._v_viewmat)
        return self._v_viewmat.numpy().copy()

    def release(self) -> None:
        """Free the memory of steps."""
        self._rasterizer.release()
        self._merged, self._scratch = None, {}

    def close(self) -> None:
        """Free all memory but that of models."""
        self.release()
        self._photos.clear()

    def _splats(self, models: Sequence[CpuModel]) -> Mapping[str, torch.Tensor]:
        """Raw parameters of the models as one, kept while they do not change."""
        parts = [model.synced() for model in models]
        if len(parts) == 1:
            return parts[0]
        before, merged = self._merged or ([], {})
        if len(before) != len(parts) or any(a is not b for a, b in zip(before, parts, strict=True)):
            arrays = [{name: t.numpy() for name, t in part.items()} for part in parts]
            merged = {name: torch.from_numpy(a) for name, a in merge_models(arrays).items()}
            self._merged = list(parts), merged
        return merged

    def _settings(
        self,
        background: Color,
        antialias: bool,
        *,
        sh_degree: int | None = None,
        inverse_depth: bool = False,
        disable: int = 0,
        tiles: np.ndarray | None = None,
    ) -> Settings:
        """The one place where render settings of a training are built."""
        return Settings(
            sh_degree=sh_degree,
            background=background,
            antialias=antialias,
            outputs=OUT_INVERSE_DEPTH if inverse_depth else 0,
            threads=self._threads,
            disable=disable,
            tiles=None if tiles is None else torch.from_numpy(tiles),
        )


def assert_finite(model: CpuModel, loss: float, *, step: int, view: str) -> None:
    """Raise GsError naming the loss or the first gradient that is not finite."""
    if not math.isfinite(loss):
        raise GsError(f"Step {step}, view {view}: the loss is {loss}.")
    for name, grad in model.grads.items():
        bad = int((~torch.isfinite(grad)).reshape(len(model), -1).any(dim=1).sum())
        if bad:
            raise GsError(
                f"Step {step}, view {view}: the gradient of {name} is not finite for {bad} of "
                f"{count_text(len(model), 'splat')}."
            )
