"""Step budget: steps that fit a time limit, so that schedules end when the time does."""

import math
from collections.abc import Callable

from ..estimate.cost import Cost
from ..schedule.plan import Plan

_MOST_STEPS = 1_000_000
FIRST_STEPS = 10
"""Steps after which the speed of the machine is known for the first time."""
_SHARE = 0.01
"""Of the budget: how often the number of steps is fitted to what is left of it."""


class StepBudget:
    """Fits the length of a run to a budget of seconds, again and again.

    Machines slow down, other programs come and go, and captures grow more or fewer splats than
    one expects. The plan of a run depends on its length alone, so changing the length moves all
    schedules on, or back, to where they should be.
    """

    def __init__(self, budget: float, plan_of: Callable[[int], Plan]) -> None:
        """`budget`: seconds; `plan_of`: the plan of a run of that many steps."""
        self._budget = budget
        self._plan_of = plan_of
        self._last = -math.inf

    def due(self, step: int, elapsed: float) -> bool:
        """Whether the length should be fitted after `step`, `elapsed` seconds into the run."""
        if step < FIRST_STEPS:
            return elapsed >= self._budget
        return elapsed >= self._budget or elapsed - self._last >= _SHARE * self._budget

    def length(self, step: int, *, splats: int, elapsed: float, pace: float) -> int:
        """Steps of the longest run that ends in time.

        Args:
            step: Steps taken.
            splats: How many there are.
            elapsed: Seconds since the start.
            pace: Seconds that pass for each second that the plan expects.

        Returns:
            At least `step`: the run is to end now.
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
        return Cost(self._plan_of(iterations)).seconds_after(step, splats)
