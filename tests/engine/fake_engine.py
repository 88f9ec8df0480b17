"""Fake engine: answers as an engine does, by rules that take no time, for tests of the trainer."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from enum import StrEnum, auto

import numpy as np

from gscore.engine.base import (
    ENGINE_SKIPS,
    Color,
    Columns,
    Contribution,
    CostModel,
    DrawnPicture,
    Engine,
    EngineInfo,
    EngineModel,
    Feature,
    RowEdit,
    StepNumbers,
    StepPhoto,
    StepRequest,
    column_key,
    counters_of,
)
from gscore.raster.request import Frustum
from gscore.splats import PARAMETERS, SH_REST_BY_DEGREE

PENDING_SIZE = 256


class FakeModel(EngineModel):
    """Parameters, moments and counters in numpy; the moments count the steps of each row."""

    def __init__(
        self,
        columns: Columns,
        counters: Sequence[str] = (),
        engine: "FakeEngine | None" = None,
    ) -> None:
        self.engine = engine or FakeEngine()
        self.params = {name: np.array(columns[name]) for name in PARAMETERS}
        self.first = {name: np.zeros_like(p) for name, p in self.params.items()}
        self.second = {name: np.zeros_like(p) for name, p in self.params.items()}
        self.rows = {name: np.zeros(len(self), np.float32) for name in counters}
        self.adam_steps = dict.fromkeys(PARAMETERS, 0)

    def __len__(self) -> int:
        return len(self.params["means"])

    @property
    def widths(self) -> dict[str, tuple[int, ...]]:
        return {name: column.shape[1:] for name, column in (self.params | self.rows).items()}

    def column(self, name: str) -> np.ndarray:
        return (self.params | self.rows)[name].copy()

    def edit(self, edit: RowEdit) -> None:
        columns = self.params | self.rows
        rows = slice(None) if edit.rows is None else edit.rows
        for name, values in edit.values.items():
            columns[name][rows] = values
        for name in edit.forget:
            self.first[name][rows] = self.second[name][rows] = 0
        if edit.moved is not None:
            for column in self.params.values():
                column[edit.moved] = column[edit.sources]
            for column in (*self.first.values(), *self.second.values(), *self.rows.values()):
                column[edit.moved] = 0
        keep = np.arange(len(self)) if edit.keep is None else edit.keep
        if edit.morton:
            keep = keep[np.argsort(self.params["means"][keep, 0], kind="stable")]
        parents = np.zeros(0, np.int64) if edit.parents is None else edit.parents
        for name, column in self.params.items():
            new = edit.changes.get(name, column[parents])
            self.params[name] = np.concatenate([column[keep], new])
        for columns in (self.first, self.second, self.rows):
            for name, column in columns.items():
                new = np.zeros((len(parents), *column.shape[1:]), column.dtype)
                columns[name] = np.concatenate([column[keep], new])

    def widen_sh(self, degree: int) -> None:
        missing = SH_REST_BY_DEGREE[degree] - self.params["shN"].shape[1]
        for columns in (self.params, self.first, self.second) if missing > 0 else ():
            columns["shN"] = np.pad(columns["shN"], ((0, 0), (0, missing), (0, 0)))

    def clamp_runaways(self, extent: float) -> int:
        bad = ~np.isfinite(self.params["means"]).all(axis=1)
        for column in (*self.params.values(), *self.first.values(), *self.second.values()):
            column[bad] = 0
        self.params["opacities"][bad] = -20
        return int(bad.sum())

    def finish(self) -> None:
        self.drop_moments()

    def drop_moments(self) -> None:
        self.first.clear()
        self.second.clear()

    def save(self) -> Columns:
        last = max((request.step for request in self.engine.requests), default=0)
        self.engine.lost |= self.engine.faults.get(last) is Fault.LOST_WHEN_SAVED
        self.engine.check_present()
        out = {column_key(name): p for name, p in self.params.items()}
        out |= {f"m1/{name}": m for name, m in self.first.items()}
        out |= {f"m2/{name}": m for name, m in self.second.items()}
        out |= {"gathered/shN": np.zeros_like(self.params["shN"]), "drift": np.zeros(PENDING_SIZE)}
        return out | {column_key(name): counter for name, counter in self.rows.items()}


class Fault(StrEnum):
    """What goes wrong in a step of a fake engine."""

    RAISES = auto()
    """The step cannot be requested."""
    LOST = auto()
    """The device is lost: the result raises, and everything after it."""
    LOST_WHEN_SAVED = auto()
    """The device is lost when the model is saved after this step."""
    NAN = auto()
    """The loss and the slopes are NaN, but the step is not said to be skipped."""
    OTHER_STEP = auto()
    """The result is that of the step before."""
    INTERRUPTED = auto()
    """No result comes until the user presses Ctrl-C."""


class Answer:
    """A step: computed when it is requested, known when its result is read, once."""

    def __init__(self, engine: "FakeEngine", numbers: StepNumbers) -> None:
        self.engine = engine
        self.numbers = numbers

    def result(self) -> StepNumbers:
        engine, step = self.engine, self.numbers.step
        engine.unread.remove(step)
        fault = engine.faults.get(step)
        if fault is Fault.INTERRUPTED:
            raise KeyboardInterrupt
        engine.lost |= fault is Fault.LOST
        engine.check_present()
        if fault is Fault.NAN:
            slopes = np.full_like(self.numbers.slopes, np.nan)
            return self.numbers._replace(loss=np.nan, mse=np.nan, slopes=slopes)
        return self.numbers._replace(step=step - (fault is Fault.OTHER_STEP))


def _trace(request: StepRequest, photo: StepPhoto) -> float:
    """A number that differs where a step has another view, photo, size, pose or background."""
    view, mask = request.view, np.zeros(1) if photo.mask is None else photo.mask
    seen = [request.photo, view.width, view.height, request.drop_rate, *request.background]
    seen += [photo.image.mean() / 255, photo.image[0].mean() / 255, mask.mean() / 255]
    parts = [*seen, *np.asarray(view.viewmat).ravel(), *np.asarray(view.K).ravel() / 100]
    return float(np.sin(request.step + np.arange(len(parts))) @ np.array(parts, float))


class FakeEngine(Engine[FakeModel]):
    """A step adds its rate to all parameters, and traces of what was requested; pictures have the
    mean colour of the splats."""

    def __init__(self, in_flight: int = 0, faults: Mapping[int, Fault] | None = None) -> None:
        """`faults`: by step."""
        self.in_flight = in_flight
        self.faults = dict(faults or {})
        self.info = EngineInfo(
            name="fake",
            numerics="fake",
            threads=1,
            features=frozenset(Feature),
            skips=ENGINE_SKIPS,
            cost=CostModel(step=1e-3, pixel=0, splat=0, number=0),
        )
        self.photos: dict[int, StepPhoto] = {}
        self.requests: list[StepRequest] = []
        self.unread: list[int] = []
        """Steps whose results were not read."""
        self.most_unread = 0
        """Most of them when a step was requested."""
        self.lost = False
        self.closed = False

    def check_present(self) -> None:
        """Raise an error if the device is lost."""
        if self.lost:
            raise RuntimeError("VK_ERROR_DEVICE_LOST")

    def model(
        self, columns: Columns, *, counters: Sequence[str] = (), frozen: Columns | None = None
    ) -> FakeModel:
        return FakeModel(columns, counters, self)

    def load(self, saved: Columns, adam_steps: Mapping[str, int], like: FakeModel) -> FakeModel:
        self.check_present()
        columns = {name: saved[f"param/{name}"] for name in PARAMETERS}
        model = FakeModel(columns, engine=self)
        model.first = {name: saved[f"m1/{name}"] for name in PARAMETERS}
        model.second = {name: saved[f"m2/{name}"] for name in PARAMETERS}
        model.rows = counters_of(saved)
        model.adam_steps = dict(adam_steps)
        return model

    def put(self, key: int, photo: StepPhoto) -> None:
        self.photos[key] = photo

    def step(self, model: FakeModel, request: StepRequest) -> Answer:
        self.check_present()
        assert len({*self.unread, request.step}) <= 1 + self.in_flight, "too many steps in flight"
        if self.faults.get(request.step) is Fault.RAISES:
            raise RuntimeError("out of device memory")
        photo = self.photos.pop(request.photo)
        self.requests.append(request)
        self.unread.append(request.step)
        self.most_unread = max(self.most_unread, len(set(self.unread)))
        mse = float(np.mean((photo.image / 255.0 - self._color([model])) ** 2))
        for name, rate in request.rates.items():
            model.params[name] += np.float32(1e-3 * rate)
            model.first[name] += 1
            model.adam_steps[name] += 1
        model.params["means"] += np.float32(request.noise * 1e-9)
        model.params["means"] += np.float32(1e-6 * _trace(request, photo))
        if request.gain is not None:  # so that a late gain shows in the splats
            model.params["sh0"] += np.float32(1e-3 * request.gain[0])
        for name in request.observe:
            model.rows[name] += 1
        slopes = np.full((1, 19), np.sin(request.step + request.photo))
        return Answer(
            self,
            StepNumbers(
                step=request.step,
                loss=mse,
                mse=mse,
                slopes=slopes,
                bad_rows=0,
                lost_rows=0,
                skipped=False,
                seconds={"draw": 0.0},
                raster={"entries": 1},
            ),
        )

    def draw(
        self,
        models: Sequence[FakeModel],
        view: Frustum,
        *,
        background: Color,
        antialias: bool,
        inverse_depth: bool = False,
        scaling: float = 1.0,
    ) -> DrawnPicture:
        size = view.height, view.width
        rgb = np.full((*size, 3), self._color(models), np.float32)
        return DrawnPicture(rgb, np.ones(size, np.float32), np.ones(size, np.float32))

    def contributions(
        self, model: FakeModel, views: Iterable[tuple[Frustum, StepPhoto]], *, antialias: bool
    ) -> Iterator[Contribution]:
        for _ in views:
            weights = np.arange(len(model), dtype=np.float32)
            yield Contribution(weights, weights)

    def pose_gradient(
        self,
        models: Sequence[FakeModel],
        view: Frustum,
        photo: StepPhoto,
        *,
        background: Color,
        antialias: bool,
    ) -> np.ndarray:
        return np.zeros((4, 4), np.float32)

    def close(self) -> None:
        self.closed = True

    def _color(self, models: Sequence[FakeModel]) -> np.ndarray:
        return np.mean([0.5 + 0.28 * m.params["sh0"].mean(axis=(0, 1)) for m in models], axis=0)
