"""Stopping controller: the length of a run in progress, from its time budget and its PSNR."""

from typing import Any

from ...events import CONVERGED, FINISHED, TARGET
from ..evaluation import Evaluator
from ..trainer import Trainer
from .criteria import StoppingCriteria
from .progress_meter import ProgressMeter
from .step_budget import FIRST_STEPS, StepBudget


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
