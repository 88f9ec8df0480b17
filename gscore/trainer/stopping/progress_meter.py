"""Progress meter: smoothed losses of a run, its clock, and the history for the report."""

import math
import time
from collections import deque
from typing import Any

from ...engine.base import CostModel
from ...engine.cpu.pace import COST
from ...events import Progress, finite
from ..estimate.cost import Cost
from ..model.checkpoint_schema import as_float, as_int, as_records
from ..schedule.plan import Plan

_EVENTS_PER_SECOND = 5.0
_HISTORY = 500
_ROWS_A_FIT = 8
"""Rows of the history between two forecasts of the remaining time for `_MEMORY`."""
_WINDOW = 50
_WARMUP = 5
"""Number of first steps that are excluded from the pace, because they are slower."""
_MEMORY = (2.0, 0.1)
"""Averaging window of the pace: least planned seconds, and share of the remaining ones. With other
programs running, the last dozens of steps alone vary too much."""


class ProgressMeter:
    """Measures a run step by step; only time spent in steps and comparisons of photos counts."""

    def __init__(
        self,
        plan: Plan,
        *,
        splats: int,
        pace: float = 1.0,
        budget: float = math.inf,
        cost: CostModel = COST,
    ) -> None:
        """Create a meter.

        Args:
            plan: Plan of the run.
            splats: Number of splats before the first step.
            pace: Initially expected seconds per planned second.
            budget: Seconds after which the run ends.
            cost: Seconds of a step of the engine.
        """
        self._cost = Cost(plan, cost)
        self.train_seconds = 0.0
        """Seconds in steps and comparisons of photos, without evaluation, files and pauses."""
        self.history: list[dict[str, Any]] = []
        """Fields of Progress and the divisor of the photos' sides, at about 500 evenly spaced
        steps; None for numbers that are not finite."""
        self._loss = math.nan
        self._mse = math.nan
        self._count = 0
        self._step = 0
        self._splats = splats
        self._budget = budget
        self._expect(pace)
        self._warmup = _WARMUP
        self._recent: deque[tuple[float, int]] = deque(maxlen=_WINDOW)
        self._last_event = -math.inf

    @property
    def plan(self) -> Plan:
        """Plan of the run, which may change during the run."""
        return self._cost.plan

    @plan.setter
    def plan(self, plan: Plan) -> None:
        if plan is not self._cost.plan:
            self._cost = Cost(plan, self._cost.model)

    def update(
        self,
        *,
        step: int,
        loss: float,
        mse: float,
        splats: int,
        seconds: float,
        photos: int = 1,
        photo_factor: float = 1.0,
    ) -> None:
        """Add a step that took `seconds` on a batch of `photos`, whose sides were divided by
        `photo_factor`."""
        self.train_seconds += seconds
        if self._warmup:
            self._warmup -= 1
        else:
            planned = self._cost.seconds_at(step, self._splats) * photos
            kept = math.exp(-planned / self._memory)
            self._spent = kept * self._spent + seconds
            self._planned = kept * self._planned + planned
        self._recent.append((seconds, photos))
        self._step, self._splats = step, splats
        if math.isfinite(loss) and math.isfinite(mse):
            # Arithmetic mean of the first _WINDOW steps, then exponential.
            self._count += 1
            weight = 1.0 / min(self._count, _WINDOW)
            first = self._count == 1
            self._loss = loss if first else self._loss + weight * (loss - self._loss)
            self._mse = mse if first else self._mse + weight * (mse - self._mse)
        every = max(1, self.plan.iterations // _HISTORY)
        if step // every > (step - photos) // every or step == self.plan.iterations:
            if len(self.history) % _ROWS_A_FIT == 0:
                self._fit_memory()
            row = finite(self._figures())
            self.history.append(row | {"photo_factor": photo_factor})

    def add(self, seconds: float) -> None:
        """Add the seconds of work between two steps, which is part of neither pace nor forecast."""
        self.train_seconds += seconds

    @property
    def psnr(self) -> float:
        """PSNR of the smoothed mean squared error, dB."""
        return -10 * math.log10(max(self._mse, 1e-12))

    @property
    def pace(self) -> float:
        """Expected seconds per planned second: first as given, then more and more as measured."""
        return self._spent / self._planned

    def _planned_left(self) -> float:
        """Planned seconds that are left."""
        return self._cost.seconds_after(self._step, self._splats)

    def _fit_memory(self) -> None:
        """Fit the averaging window of the pace to the remaining time."""
        self._memory = max(_MEMORY[0], _MEMORY[1] * self._planned_left())

    def _expect(self, pace: float) -> None:
        """Restart the measurement with an expected pace."""
        self._planned = self._cost.model.trust
        self._spent = self._planned * pace
        self._fit_memory()

    def progress(self, *, phase: str = "") -> Progress:
        """Return the current progress as an event."""
        left = self.pace * self._planned_left()
        left = min(left, max(self._budget - self.train_seconds, 0.0))
        figures: dict[str, Any] = self._figures() | ({"phase": phase} if phase else {})
        return Progress(iterations=self.plan.iterations, eta_s=left, **figures)

    def _figures(self) -> dict[str, Any]:
        """Fields of Progress for the history."""
        spent = sum(seconds for seconds, _ in self._recent)
        return {
            "step": self._step,
            "elapsed_s": self.train_seconds,
            "loss": self._loss,
            "psnr": self.psnr,
            "splats": self._splats,
            "steps_per_s": sum(n for _, n in self._recent) / spent if spent > 0 else 0.0,
            "phase": "adding splats" if self._step <= self.plan.refine_stop else "refining",
        }

    def due(self) -> bool:
        """Return whether to emit a progress event now: a few per second, and at the last step."""
        now = time.monotonic()
        last = self._step >= self.plan.iterations
        if not last and now - self._last_event < 1 / _EVENTS_PER_SECOND:
            return False
        self._last_event = now
        return True

    def rewind(self, step: int, *, splats: int) -> None:
        """Discard the steps after `step`, which ended with `splats`, but not their time."""
        self.history = [entry for entry in self.history if entry["step"] <= step]
        self._step, self._splats, self._count = step, splats, 0
        self._expect(self.pace)
        self._recent.clear()

    def state(self) -> dict[str, Any]:
        """State for `restore`, as JSON values."""
        return {
            "train_seconds": self.train_seconds,
            "history": self.history,
            "loss": self._loss,
            "mse": self._mse,
            "count": self._count,
            "step": self._step,
            "splats": self._splats,
            "pace": self.pace,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Restore the values of `state`; ValueError or KeyError if they are invalid."""
        self.train_seconds = as_float("train_seconds", state["train_seconds"], low=0)
        self.history = as_records("history", state["history"])
        self._loss = as_float("loss", state["loss"], finite=False)
        self._mse = as_float("mse", state["mse"], finite=False)
        self._count = as_int("count", state["count"])
        self._step = as_int("step", state.get("step", 0))
        self._splats = as_int("splats", state.get("splats", self._splats))
        self._expect(as_float("pace", state.get("pace", self.pace), low=0))
