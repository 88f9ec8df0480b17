"""GPU engine: training steps and pictures by a device, two steps in flight."""

import ctypes as ct
import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress

import numpy as np

from ...errors import GsError
from ...raster import arguments
from ...raster.buffers import UINT8, address, optional
from ...raster.gpu import header
from ...raster.gpu.gpu_raster import GpuRaster
from ...raster.gpu.library import DeviceMemoryError, DeviceWrongError
from ...raster.header import MASK_MODES, OUT_INVERSE_DEPTH, TILE
from ...raster.request import Frustum, Settings
from ...splats import PARAMETERS
from .. import base
from ..base import Color, Columns, Feature, ShUpdate, StepNumbers, StepPhoto, StepRequest, TermKind
from ..ensemble import merge_models
from .model import GpuModel
from .photos import KeptPhotos
from .small_training import small_training

FEATURES = frozenset(base.Feature) - {Feature.ANOMALIES, Feature.SURFACE}
"""Features that it has."""
IN_FLIGHT = 2
"""Steps in flight; a constant, so that results do not depend on time."""
CARD_COST = base.CostModel(step=2e-3, pixel=2e-9, splat=4e-9, number=0.0, trust=0.02)
"""Cost of a card: a guess, which ten steps replace, because none was measured."""
SOFTWARE_COST = base.CostModel(step=2e-2, pixel=5.5e-6, splat=1.3e-5, number=0.0)
"""Cost of lavapipe on two cores: 500 and 10,000 splats in photos of 32 and 128 px."""
_NO_SLOPES = np.zeros((1, 19))
"""Slopes of a step without gain and pose."""
_SHARED_BYTES = 400_000_000
"""Bytes of a submission on a shared device: 20 ms of a slow card, which moves 20 GB a second."""
_LONGEST_PAUSE = 1.0
"""Seconds of the longest pause after a step of a shared device."""
_SH_UPDATES = {
    ShUpdate.OFF: header.SH_OFF,
    ShUpdate.ACCUMULATE: header.SH_ACCUMULATE,
    ShUpdate.STEP: header.SH_STEP,
}


class PendingStep:
    """A step in flight."""

    def __init__(
        self, engine: "GpuEngine", model: GpuModel, request: StepRequest, *, updates: bool = True
    ) -> None:
        """Count the Adam steps of a request; `updates`: it changes the model."""
        self.model, self.request, self.updates = model, request, updates
        self.began = time.perf_counter()
        self.added = 0.0
        """Value of the picture term."""
        self.numbers: StepNumbers | None = None
        """Its result, once it was read."""
        self.error: BaseException | None = None
        self._engine = engine
        self._count(1)

    def take_back(self) -> None:
        """Count the step no longer, because it was not taken."""
        self._count(-1)

    def _count(self, change: int) -> None:
        for name in PARAMETERS if self.updates else ():
            if name != "shN" or self.request.sh_update is ShUpdate.STEP:
                self.model.adam_steps[name] += change

    def result(self) -> StepNumbers:
        """Wait for the step and return its numbers; errors of the step are raised here."""
        while self.numbers is None and self.error is None:
            self._engine.read_next()
        if self.error is not None:
            raise self.error
        assert self.numbers is not None
        return self.numbers


class GpuEngine(base.Engine[GpuModel]):
    """Engine that computes on a device, which it closes."""

    def __init__(
        self,
        raster: GpuRaster,
        *,
        name: str,
        numerics: str,
        cost: base.CostModel = SOFTWARE_COST,
        on_wrong: Callable[[str], None] = lambda problem: None,
        is_card: bool = False,
    ) -> None:
        """Take over an open device.

        Args:
            raster: The device.
            name: Its name.
            numerics: Identity of its bits, see `EngineInfo.numerics`.
            cost: Seconds of its steps.
            on_wrong: Receives a sentence if the device computes wrong results.
            is_card: Whether it is a graphics card.
        """
        self.in_flight = IN_FLIGHT
        self.info = base.EngineInfo(
            name=name,
            numerics=numerics,
            is_card=is_card,
            features=FEATURES,
            memory=raster.memory()[1],
            cost=cost,
        )
        """Identity and capabilities."""
        self._share = 1.0
        self._raster = raster
        self._peak = 0
        self._photos: dict[int, StepPhoto] = {}
        self._unread: deque[tuple[int, PendingStep]] = deque()
        """Slots and steps in flight, in their order."""
        self._kept = KeptPhotos(raster)
        self._on_wrong = on_wrong
        self._first_result = b""
        """Hash of the first `small_training`; empty: none yet."""
        self._problem = ""
        """Sentence on wrong results; empty: none were found."""
        raster.wait_for_steps = self.read_all
        raster.make_room = self._kept.make_room

    def model(
        self, columns: Columns, *, counters: Sequence[str] = (), frozen: Columns | None = None
    ) -> GpuModel:
        """Create a model, see `Engine.model`."""
        return GpuModel(self._raster, columns, counters=counters, frozen=frozen)

    def load(self, saved: Columns, adam_steps: Mapping[str, int], like: GpuModel) -> GpuModel:
        """Create a model from `EngineModel.save`, see `Engine.load`."""
        return GpuModel.load(self._raster, saved, adam_steps, frozen=like.frozen)

    def put(self, key: int, photo: StepPhoto) -> None:
        """Provide a photo for the next step that names it."""
        self._photos[key] = photo

    def step(self, model: GpuModel, request: StepRequest) -> base.Pending:
        """Start a step, see `StepRequest`."""
        photo = self._photos.pop(request.photo)
        if request.picture_term is not None:
            # An earlier step that is repeated changes the picture, and the term with it.
            self.read_all()
        pending = PendingStep(self, model, request)
        began = time.perf_counter()
        self._start(pending, photo, key=request.photo)
        if self._share < 1:
            self.read_all()
            busy = time.perf_counter() - began
            time.sleep(min(busy * (1 / self._share - 1), _LONGEST_PAUSE))
        return pending

    def use_share(self, share: float) -> None:
        """Pause after each step, see `Engine.use_share`."""
        self._share = share
        if share < 1:
            self.shorten_submissions()

    def shorten_submissions(self) -> None:
        """Use submissions of 20 ms, see `Engine.shorten_submissions`."""
        lib = self._raster.library
        self._raster.call(lib.gs_gpu_shorten_submissions, _SHARED_BYTES)

    def _start(self, pending: PendingStep, photo: StepPhoto, *, key: int | None = None) -> None:
        """Start a step in a free slot; `key`: of a photo that may stay on the device."""
        kept, written = (None, False) if key is None else self._kept.handle_of(key, photo)
        while len(self._unread) > IN_FLIGHT:
            self.read_next()
        used = {slot for slot, _ in self._unread}
        slot = next(one for one in range(header.STEPS_MAX) if one not in used)
        self._unread.append((slot, pending))
        try:
            try:
                self._submit(slot, step_struct(pending, photo, kept=kept, written=written))
            except DeviceMemoryError:
                self._unread.pop()  # it is not in flight, and those that are have no error
                self.read_all()
                has_room = self._kept.make_room()
                self._unread.append((slot, pending))
                if not has_room:
                    raise
                self._submit(slot, step_struct(pending, photo))
            if pending.request.picture_term is not None:
                self._add_term(pending, slot)
        except BaseException as error:
            if key is not None and not written:
                self._kept.forget(key)
            self._drop(error)
            raise

    def _submit(self, slot: int, step: ct.Structure) -> None:
        """Start the last of the steps in flight."""
        rows = self._unread[-1][1].model.rows
        request = self._raster.library.gs_gpu_step_request
        self._raster.call(request, rows.handle, ct.byref(step), slot, waits=False)

    def _drop(self, error: BaseException) -> None:
        """Give up all steps in flight after an error, which is theirs too."""
        for _, pending in self._unread:
            pending.error = error
            pending.take_back()
        self._unread.clear()
        with suppress(GsError):
            self.release()

    def _add_term(self, pending: PendingStep, slot: int) -> None:
        """Compute a further loss term of a picture that waits for it."""
        view, lib = pending.request.view, self._raster.library
        pictures = [np.empty((view.height, view.width), np.float32) for _ in range(2)]
        size = view.height, view.width
        found = [address(n, p, size) for n, p in zip(("depth", "alpha"), pictures, strict=True)]
        self._raster.call(lib.gs_gpu_step_picture, slot, *found, waits=False)
        assert pending.request.picture_term is not None
        term = pending.request.picture_term(*pictures)
        pending.added = term.value
        gradients = [
            optional(name, None if v is None else np.ascontiguousarray(v, np.float32), size)
            for name, v in (("v_inverse_depth", term.v_inverse_depth), ("v_alpha", term.v_alpha))
        ]
        self._raster.call(lib.gs_gpu_step_resume, slot, term.value, *gradients, waits=False)

    def read_next(self) -> None:
        """Wait for the first step in flight and keep its numbers or its error."""
        slot, pending = self._unread[0]
        found = header.GpuStepNumbersStruct()
        try:
            lib = self._raster.library
            self._raster.call(lib.gs_gpu_step_result, slot, ct.byref(found), waits=False)
        except Exception as error:
            self._drop(error)
            return
        self._unread.popleft()
        request = pending.request
        loss = found.loss + pending.added
        skipped = bool(found.skipped)
        if skipped:
            pending.take_back()
        slopes = _NO_SLOPES
        if (request.gain is not None or request.learn_pose) and not skipped:
            gain = [0.0] * 3 if request.gain is None else found.v_log_gain
            slopes = np.array([[*gain, *found.v_viewmat]], np.float64)
        pending.numbers = StepNumbers(
            step=request.step,
            loss=loss,
            mse=found.mse,
            slopes=slopes,
            bad_rows=found.bad_rows,
            lost_rows=found.lost_rows,
            skipped=skipped,
            seconds={"device": time.perf_counter() - pending.began},
            raster={"visible": found.visible, "entries": found.entries},
        )

    def read_all(self) -> None:
        """Wait for all steps in flight; their numbers stay for `PendingStep.result`."""
        while self._unread:
            self.read_next()

    def draw(
        self,
        models: Sequence[GpuModel],
        view: Frustum,
        *,
        background: Color,
        antialias: bool,
        inverse_depth: bool = False,
        scaling: float = 1.0,
    ) -> base.DrawnPicture:
        """Draw the current models, see `Engine.draw`."""
        outputs = OUT_INVERSE_DEPTH if inverse_depth else 0
        settings = Settings(background=background, antialias=antialias, outputs=outputs)
        size = view.height, view.width
        pictures = {"rgb": np.empty((*size, 3), np.float32), "alpha": np.empty(size, np.float32)}
        if inverse_depth:
            pictures["inverse_depth"] = np.empty(size, np.float32)
        if len(models) == 1 and scaling == 1:
            models[0].rows.draw(view, settings, pictures, sh_degree=models[0].sh_degree)
        else:
            splats = dict(_merged(models))
            splats["scales"] = splats["scales"] + np.float32(math.log(scaling))
            self._raster.forward([splats[name] for name in PARAMETERS], view, settings, pictures)
        return base.DrawnPicture(**pictures)

    def contributions(
        self, model: GpuModel, views: Iterable[tuple[Frustum, StepPhoto]], *, antialias: bool
    ) -> Iterator[base.Contribution]:
        """Yield the contributions of the splats to each view."""
        self.release()  # they need other memory than steps
        settings = Settings(antialias=antialias)
        for view, photo in views:
            shares = np.ones((view.height, view.width, 3), np.float32)
            if photo.mask_mode == "ignore" and photo.mask is not None:
                shares[..., 0] = photo.mask.astype(np.float32) / 255
            size = view.height, view.width
            pictures = {"rgb": np.empty((*size, 3), np.float32)}
            pictures |= {"alpha": np.empty(size, np.float32)}
            model.rows.draw(view, settings, pictures, sh_degree=0)
            sums = model.rows.weights(view, shares)
            yield base.Contribution(sums[:, 0].copy(), sums[:, 1].copy())

    def pose_gradient(
        self,
        models: Sequence[GpuModel],
        view: Frustum,
        photo: StepPhoto,
        *,
        background: Color,
        antialias: bool,
    ) -> np.ndarray:
        """Return the gradient of a view's loss in its pose, see `Engine.pose_gradient`."""
        model = models[0]
        if len(models) > 1:
            model = GpuModel(self._raster, _merged(models), frozen=None)
        request = StepRequest(
            step=0,
            photo=0,
            view=view,
            background=background,
            shown_background=background,
            antialias=antialias,
            sh_degree=model.sh_degree,
            sh_update=ShUpdate.OFF,
            rates=dict.fromkeys(PARAMETERS, 0.0),
            terms=((TermKind.L1, 0.8), (TermKind.SSIM, 0.2)),
            learn_pose=True,
            extent=1.0,
        )
        pending = PendingStep(self, model, request, updates=False)
        self._start(pending, photo)
        return pending.result().slopes[0, 3:].reshape(4, 4).astype(np.float32)

    def verify(self) -> None:
        """Repeat a small training, see `Engine.verify`.

        Raises:
            DeviceWrongError: its result is another one, now or in an earlier call.
        """
        if not self._problem:
            found = small_training(self)
            self._first_result = self._first_result or found
            if found != self._first_result:
                self._problem = (
                    f"{self.info.name} no longer computes what it did when the training began. "
                    "Overheated and overclocked cards do this, and damaged drivers."
                )
                self._on_wrong(self._problem)
        if self._problem:
            raise DeviceWrongError(
                f"{self._problem} Run `gscore doctor --verify`, or use `--device cpu`."
            )

    def keep_photos(self, room: int) -> None:
        """Let photos stay on the device, up to `room` bytes of them."""
        self._kept.room = room

    def peak_memory(self) -> int:
        """Most bytes of device memory in use so far."""
        if self._raster.usable:
            self._peak = self._raster.memory()[0]
        return self._peak

    def release(self) -> None:
        """Free the memory of steps, after those in flight."""
        self._raster.call(self._raster.library.gs_gpu_steps_release)

    def close(self) -> None:
        """Free the device."""
        self._unread.clear()
        self._photos.clear()
        self.peak_memory()
        self._raster.close()


def _merged(models: Sequence[GpuModel]) -> Columns:
    """Raw parameters of several models as one, frozen splats first."""
    if len(models) == 1 and models[0].frozen is not None:
        # Frozen splats have their own degree.
        own, frozen = models[0].part(0, len(models[0])), dict(models[0].frozen)
        rest = own["shN"].shape[1]
        missing = rest - frozen["shN"].shape[1]
        frozen["shN"] = np.pad(frozen["shN"], ((0, 0), (0, missing), (0, 0)))
        return {name: np.concatenate([frozen[name], own[name]]) for name in PARAMETERS}
    return merge_models([model.part(0, len(model)) for model in models])


def step_struct(
    pending: PendingStep,
    photo: StepPhoto,
    *,
    kept: ct.c_void_p | None = None,
    written: bool = False,
) -> ct.Structure:
    """gs_gpu_step of a request; its arrays must live until it was started.

    `kept`: handle of the photo, if it stays on the device; `written`: it is there already.
    """
    model, request = pending.model, pending.request
    view, weights = request.view, dict(request.terms)
    outputs = OUT_INVERSE_DEPTH if request.picture_term is not None else 0
    settings = Settings(background=request.background, antialias=request.antialias, outputs=outputs)
    size = view.height, view.width
    masked = photo.mask is not None
    stream = base.STREAMS * request.place
    counters = [model.counter(name) for name in request.observe] or [-1, -1]
    tile_shape = (-(-view.height // TILE), -(-view.width // TILE))
    found = header.GpuStepStruct(
        view=arguments.view(view, settings, request.sh_degree),
        photo=None if written else address("photo", photo.image, (*size, 3), UINT8),
        mask=None if written else optional("mask", photo.mask, size, UINT8),
        kept=kept,
        tiles=optional("tiles", request.tiles_of(photo), tile_shape, UINT8),
        mask_mode=MASK_MODES[photo.mask_mode] if masked else MASK_MODES["none"],
        counted=photo.counted,
        ssim_weight=weights[TermKind.SSIM],
        mask_alpha=weights.get(TermKind.MASK_ALPHA, 0.0),
        see_through=weights.get(TermKind.SEE_THROUGH, 0.0),
        has_gain=request.gain is not None,
        has_blur=request.blur is not None,
        sh_update=_SH_UPDATES[request.sh_update],
        seed=request.seed,
        number=request.step,
        drop_stream=stream + base.DROPOUT_STREAM,
        noise_stream=stream + base.NOISE_STREAM,
        drop_rate=request.drop_rate,
        noise=request.noise,
        opacity_reg=request.opacity_reg,
        scale_reg=request.scale_reg,
        gradient_counter=counters[0],
        view_counter=counters[1],
        learns_pose=request.learn_pose,
        updates=pending.updates,
        pauses=request.picture_term is not None,
        extent=request.extent,
    )
    found.shown_background = (ct.c_float * 3)(*request.shown_background)
    found.gain = (ct.c_float * 3)(*(request.gain or (1.0, 1.0, 1.0)))
    found.blur = (ct.c_float * 3)(*(request.blur or (0.0, 0.0, 0.0)))
    found.rates = (ct.c_float * 6)(*(request.rates[name] for name in PARAMETERS))
    found.steps = (ct.c_int64 * 6)(*(model.adam_steps[name] for name in PARAMETERS))
    return found
