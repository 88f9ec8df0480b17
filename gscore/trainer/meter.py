"""Smoothed numbers of a run, its clock, and the history that the report draws."""

import math
import time
from collections import deque
from itertools import accumulate
from typing import Any

from ..events import Progress
from .schedules import Plan

_EVENTS_PER_SECOND = 5.0
_HISTORY = 500
_HISTORY_FIELDS = ("step", "elapsed_s", "loss", "psnr", "splats", "steps_per_s", "phase")
_WINDOW = 50


class Meter:
    """Follows a run step by step; only time spent in steps counts."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self.train_seconds = 0.0
        """Seconds spent in steps, without evaluation, files and pauses."""
        self.history: list[dict[str, Any]] = []
        """Some fields of Progress, at about 500 steps evenly spread; what is not finite is None."""
        self._loss = math.nan
        self._mse = math.nan
        self._count = 0
        self._step = 0
        self._splats = 0
        self._recent: deque[float] = deque(maxlen=_WINDOW)
        work = [plan.work_at(step) for step in range(1, plan.iterations + 1)]
        self._work_done = [0.0, *accumulate(work)]
        self._last_event = -math.inf

    def update(self, *, step: int, loss: float, mse: float, splats: int, seconds: float) -> None:
        """Take note of a step that took `seconds`."""
        self.train_seconds += seconds
        self._recent.append(seconds)
        self._step, self._splats = step, splats
        if math.isfinite(loss) and math.isfinite(mse):
            # A mean over the first steps, then an exponential one over about _WINDOW.
            self._count += 1
            weight = 1.0 / min(self._count, _WINDOW)
            first = self._count == 1
            self._loss = loss if first else self._loss + weight * (loss - self._loss)
            self._mse = mse if first else self._mse + weight * (mse - self._mse)
        every = max(1, self._plan.iterations // _HISTORY)
        if step % every == 0 or step == self._plan.iterations:
            fields = vars(self.progress())
            self.history.append({key: _finite(fields[key]) for key in _HISTORY_FIELDS})

    @property
    def psnr(self) -> float:
        """Of the smoothed mean squared error, dB."""
        return -10 * math.log10(max(self._mse, 1e-12))

    def progress(self, *, phase: str = "") -> Progress:
        """Where the run stands."""
        recent = sum(self._recent)
        rate = len(self._recent) / recent if recent > 0 else 0.0
        # The last steps took as long as their share of the work says, and so will those to come.
        work = self._work_done
        lately = work[self._step] - work[max(self._step - len(self._recent), 0)]
        left = (work[-1] - work[self._step]) / lately if lately else math.inf
        return Progress(
            step=self._step,
            iterations=self._plan.iterations,
            loss=self._loss,
            psnr=self.psnr,
            splats=self._splats,
            steps_per_s=rate,
            eta_s=left * recent,
            elapsed_s=self.train_seconds,
            phase=phase or ("growing" if self._step <= self._plan.refine_stop else "polishing"),
        )

    def due(self) -> bool:
        """Whether a progress event should be sent now; at most a few a second."""
        now = time.monotonic()
        last = self._step >= self._plan.iterations
        if not last and now - self._last_event < 1 / _EVENTS_PER_SECOND:
            return False
        self._last_event = now
        return True

    def state(self) -> dict[str, Any]:
        """As JSON values; see `restore`."""
        return {
            "train_seconds": self.train_seconds,
            "history": self.history,
            "loss": self._loss,
            "mse": self._mse,
            "count": self._count,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from what `state` returned."""
        self.train_seconds, self.history = state["train_seconds"], list(state["history"])
        self._loss, self._mse, self._count = state["loss"], state["mse"], state["count"]


def _finite(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value
