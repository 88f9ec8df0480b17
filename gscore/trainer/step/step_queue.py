"""Step queue: steps requested of an engine, whose results are read later, in their order."""

import math
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
import torch

from ...engine.base import Engine, EngineModel, Pending, StepNumbers, StepPhoto, StepRequest
from ...errors import BackendError, GsError
from ..model.checkpoint_schema import as_int

_SLOPES = "slopes"
"""Tensor of a checkpoint, [K, 21] float64: step, photo and slopes."""
_KEPT = "The last checkpoint is kept; continue with `--resume`."


class RequestedStep(NamedTuple):
    """A step of one model that was requested."""

    indices: list[int]
    """Views of its batch, one for each rank."""
    learns: bool
    """The slopes of the result are needed."""
    pending: Pending


class Slopes(NamedTuple):
    """Derivatives of a step's loss in the gain and pose of a photo."""

    step: int
    index: int
    """The photo."""
    slopes: np.ndarray
    """[19] float64, see `StepNumbers.slopes`."""


class StepStart(NamedTuple):
    """State before a step besides its models, which are as after the steps before it."""

    views: dict[str, Any]
    """`ViewBatcher.state`."""
    generator: torch.Tensor
    photos: dict[str, np.ndarray]
    """`PhotoParameters.arrays`, copied."""
    used: int
    """Last step whose slopes were used."""


class StepQueue:
    """Requested steps, at most `depth` of which stay unread from one step to the next.

    Results are read early where all are needed, but slopes are used exactly `depth` steps after
    their own, so that a training does not depend on when they are read.
    """

    def __init__(self, engine: Engine[Any]) -> None:
        self._engine = engine
        self._unread: deque[tuple[int, list[RequestedStep], StepStart | None]] = deque()
        self._slopes: deque[Slopes] = deque()
        """Those that were not used, and those that are used again after `clear`."""
        self.used = 0
        """Last step whose slopes were used."""

    @property
    def depth(self) -> int:
        """Most steps whose results are unread after a step."""
        return self._engine.in_flight

    def request(
        self, model: EngineModel, request: StepRequest, photo: StepPhoto, indices: list[int]
    ) -> RequestedStep:
        """Request a step of a model with the photo of one of the views `indices`."""
        with engine_errors(self._engine, f"in step {request.step}"):
            self._engine.put(request.photo, photo)
            pending = self._engine.step(model, request)
        return RequestedStep(indices, request.learn_gain or request.learn_pose, pending)

    def add(self, step: int, requested: list[RequestedStep], start: StepStart | None) -> None:
        """Add a step, of all models; `start`: the state before it, for `clear`."""
        self._unread.append((step, requested, start))

    def read(self, most: int) -> Iterator[list[tuple[RequestedStep, StepNumbers]]]:
        """Yield the numbers of each model, waiting for them, until at most `most` steps are unread.

        Raises:
            BackendError: the engine failed, or answered another step.
        """
        while len(self._unread) > most:
            step, requested, _ = self._unread[0]
            with engine_errors(self._engine, f"in step {step}"):
                numbers = [self._checked(one.pending.result(), step) for one in requested]
            self._unread.popleft()  # a step that failed stays
            for one, found in zip(requested, numbers, strict=True):
                if one.learns and not found.skipped:
                    rows = zip(one.indices, found.slopes, strict=True)
                    self._slopes.extend(Slopes(step, index, row) for index, row in rows)
            yield list(zip(requested, numbers, strict=True))

    def _checked(self, found: StepNumbers, step: int) -> StepNumbers:
        """The numbers of a step, skipped if its loss is not finite."""
        if found.step != step:
            name = self._engine.info.name
            raise BackendError(
                f"The engine {name} answered step {found.step} instead of step {step}. {_KEPT}"
            )
        return found if math.isfinite(found.loss) else found._replace(skipped=True)

    def slopes_until(self, step: int) -> Iterator[Slopes]:
        """Yield the slopes of steps up to `step` that were not used yet."""
        yield from [one for one in self._slopes if self.used < one.step <= step]
        self.used = max(self.used, step)
        while self._slopes and self._slopes[0].step < self.used - self.depth:
            self._slopes.popleft()

    def drop(self) -> None:
        """Wait for all steps and drop them with their slopes, for a state that is restored."""
        for _ in self.read(0):
            pass
        self._slopes.clear()
        self.used = 0

    def clear(self) -> tuple[int, StepStart | None]:
        """Forget all steps that are unread, without waiting for them; returns the number of views
        of a model in them, and the state before the first."""
        views = sum(len(requested[0].indices) for _, requested, _ in self._unread)
        start = self._unread[0][2] if self._unread else None
        self._unread.clear()
        return views, start

    def tensors(self) -> dict[str, torch.Tensor]:
        """Slopes that were not used yet, by name, if any; all steps must be read."""
        assert not self._unread
        unused = (one for one in self._slopes if one.step > self.used)
        rows = [[one.step, one.index, *one.slopes] for one in unused]
        return {_SLOPES: torch.tensor(rows, dtype=torch.float64, device="cpu")} if rows else {}

    def restore(self, tensors: Mapping[str, torch.Tensor]) -> None:
        """Restore the slopes that `tensors` returned; ValueError if they are invalid."""
        self.drop()
        rows = tensors[_SLOPES].numpy() if _SLOPES in tensors else np.zeros((0, 21))
        if rows.ndim != 2 or rows.shape[1] != 21:
            raise ValueError(f"{_SLOPES} is {list(rows.shape)}, expected 21 numbers a photo")
        for step, index, *slopes in rows.tolist():
            place = as_int(f"a step of {_SLOPES}", int(step)), as_int(_SLOPES, int(index))
            self._slopes.append(Slopes(*place, np.array(slopes)))


@contextmanager
def engine_errors(engine: Engine[Any], where: str) -> Iterator[None]:
    """Context that turns an error of an engine into a sentence; `where`: when it came."""
    try:
        yield
    except (GsError, MemoryError):
        raise
    except Exception as error:
        what = f"{type(error).__name__}: {error}".removesuffix(": ").removesuffix(".")
        name = engine.info.name
        raise BackendError(f"The engine {name} failed {where}: {what}. {_KEPT}") from error
