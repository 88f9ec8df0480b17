"""Step budget: number of steps that fit a time limit, so that schedules end in time."""

import math
from collections.abc import Callable

from ...engine.base import CostModel
from ...engine.cpu.pace import COST
from ..estimate.cost import Cost
from ..schedule.plan import Plan

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
