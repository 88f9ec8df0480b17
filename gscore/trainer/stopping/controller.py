"""Stopping controller: the length of a run in progress, from its time budget and its PSNR."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ...config import TrainConfig
from ...engine.base import CostModel
from ...engine.cpu.pace import COST
from ...events import CONVERGED, FINISHED, TARGET
from ...metrics.evaluate import target_picture
from ...metrics.image import psnr
from ...sampling import evenly_spaced
from ..estimate.cost import Cost
from ..evaluation import Evaluator
from ..model.checkpoint_schema import as_int, as_measurements
from ..schedule.plan import Plan
from ..trainer import Trainer
from .progress_meter import ProgressMeter

_MEASURES = 40
"""Approximate number of measurements in a run."""
_FEWEST, _MOST = 25, 500
"""Limits of the steps between two measurements."""
_VIEWS = 16
"""Most views that are measured."""
_WINDOW = 0.15
"""Share of the run within which the PSNR must rise."""
_LEAST_RISE = 0.1
"""Least rise within `_WINDOW`, dB."""
_END_PHASE = 0.2
"""Share of a converged run that remains for its end phase."""


class StoppingCriteria:
    """Measures a run in progress and decides when it may end; deterministic, without a clock."""

    def __init__(self, config: TrainConfig, trainer: Trainer, evaluator: Evaluator) -> None:
        self._config = config
        self._trainer = trainer
        self._evaluator = evaluator
        self._views = evenly_spaced(evaluator.indices, _VIEWS)
        self._measured: list[tuple[int, float]] = []
        """Step and PSNR, dB, of each measurement."""
        self.length = 0
        """Last step of a converged run; 0: not converged."""

    def due(self) -> bool:
        """Return whether to measure after the last step."""
        config = self._config
        if not (config.target_psnr or (config.early_stop and not self.length)):
            return False
        every = min(max(self._trainer.plan.iterations // _MEASURES, _FEWEST), _MOST)
        return self._trainer.steps - (self._measured[-1][0] if self._measured else 0) >= every

    def measure(self) -> float:
        """Measure the mean PSNR over the views, dB, unmasked pixels only."""
        trainer, values = self._trainer, []
        trainer.engine.release()
        photos, background = trainer.photos, trainer.renderer.background
        for view in self._views:
            photo, mask = photos.image(view), photos.mask(view)
            target, weights = target_picture(photo, mask, photos.mask_mode, background)
            if weights is None or weights.any():
                values.append(psnr(self._evaluator.picture(view), target, mask=weights))
        mean = float(np.mean(values)) if values else math.nan
        self._measured.append((trainer.steps, mean))
        return mean

    def reached(self) -> bool:
        """Return whether the last measurement reaches the target PSNR."""
        target = self._config.target_psnr
        return bool(target and self._measured and self._measured[-1][1] >= target)

    def converged(self) -> bool:
        """Return whether the PSNR has just stopped rising; sets `length`."""
        if not self._config.early_stop or self.length or not self._measured:
            return False
        step, plan = self._measured[-1][0], self._trainer.plan
        if plan.factor_at(step) > 1:  # larger photos still add detail
            return False
        since = step - _WINDOW * plan.iterations
        before = [value for at, value in self._measured if at <= since]
        recent = [value for at, value in self._measured if at > since]
        if not before or max(recent) - max(before) >= _LEAST_RISE:
            return False
        self.length = min(round(step / (1 - _END_PHASE)), plan.iterations)
        return True

    def state(self) -> dict[str, Any]:
        """State for `restore`, as JSON values."""
        return {"found": self._measured, "length": self.length}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore the values of `state`; ValueError or KeyError if they are invalid."""
        self._measured = as_measurements("found", state["found"])
        self.length = as_int("length", state["length"]) if self._config.early_stop else 0


class StoppingController:
    """Changes the length of a trainer's run between two steps, for time budget and criteria."""

    def __init__(self, trainer: Trainer, meter: ProgressMeter, evaluator: Evaluator) -> None:
        self._trainer = trainer
        self._meter = meter
        budget = trainer.config.time_budget
        self._pace = (
            StepBudget(budget, trainer.plan_of, trainer.engine.info.cost) if budget else None
        )
        if budget and trainer.plan.iterations < FIRST_STEPS:
            trainer.replan(FIRST_STEPS)  # until the pace is measured
        self._goals = StoppingCriteria(trainer.config, trainer, evaluator)
        self._reached = False

    @property
    def reason(self) -> str:
        """Reason why the run is complete, one of `events.ENDED`; empty: steps are left."""
        if self._reached:
            return TARGET
        if self._trainer.steps < self._trainer.plan.iterations:
            return ""
        return CONVERGED if 0 < self._goals.length <= self._trainer.steps else FINISHED

    def steer(self) -> float | None:
        """Update the length of the run; returns the PSNR, dB, if it was measured."""
        trainer, meter, goals = self._trainer, self._meter, self._goals
        psnr = None
        if goals.due():
            psnr = goals.measure()
            self._reached = goals.reached()
            if goals.converged():
                trainer.replan(goals.length)
        if self._pace and self._pace.due(trainer.steps, meter.train_seconds):
            length = self._pace.length(
                trainer.steps,
                splats=trainer.splat_count,
                elapsed=meter.train_seconds,
                pace=meter.pace,
            )
            trainer.replan(min(length, goals.length) if goals.length else length)
        meter.plan = trainer.plan
        return psnr

    def state(self) -> dict[str, Any]:
        """State for `restore`, as JSON values."""
        return self._goals.state()

    def restore(self, state: dict[str, Any] | None) -> None:
        """Restore the values of `state`; None: the run had none."""
        if state is not None:
            self._goals.restore(state)
        self._reached = self._goals.reached()
        if self._goals.length:
            self._trainer.replan(self._goals.length)
        self._meter.plan = self._trainer.plan


_MOST_STEPS = 1_000_000
FIRST_STEPS = 10
"""Steps before the first measurement of the machine's speed."""
_SHARE = 0.01
"""Share of the budget between two updates of the number of steps."""


class StepBudget:
    """Fits the length of a run repeatedly to a budget of seconds.

    Machines slow down, the load of other programs varies, and the number of splats differs from
    the forecast. The plan of a run depends only on its length, so a new length adjusts all
    schedules.
    """

    def __init__(
        self, budget: float, plan_of: Callable[[int], Plan], cost: CostModel = COST
    ) -> None:
        """`budget`: seconds; `plan_of`: returns the plan of a run with a number of steps; `cost`:
        seconds of a step of the engine."""
        self._budget = budget
        self._plan_of = plan_of
        self._cost = cost
        self._last = -math.inf

    def due(self, step: int, elapsed: float) -> bool:
        """Return whether to fit the length after `step`, `elapsed` seconds after the start."""
        if step < FIRST_STEPS:
            return elapsed >= self._budget
        return elapsed >= self._budget or elapsed - self._last >= _SHARE * self._budget

    def length(self, step: int, *, splats: int, elapsed: float, pace: float) -> int:
        """Return the number of steps of the longest run within the budget.

        Args:
            step: Steps taken.
            splats: Number of splats.
            elapsed: Seconds since the start.
            pace: Seconds per planned second.

        Returns:
            The number; `step` if the run is to end now.
        """
        self._last = elapsed
        left = self._budget - elapsed
        fits, beyond = step, step + 1
        while beyond < _MOST_STEPS and self._seconds(beyond, step, splats) * pace <= left:
            fits, beyond = beyond, step + 2 * (beyond - step)
        while beyond - fits > 1:
            middle = (fits + beyond) // 2
            if self._seconds(middle, step, splats) * pace <= left:
                fits = middle
            else:
                beyond = middle
        return max(fits, 1)

    def _seconds(self, iterations: int, step: int, splats: int) -> float:
        return Cost(self._plan_of(iterations), self._cost).seconds_after(step, splats)
