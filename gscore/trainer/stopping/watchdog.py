"""Watchdog: detects divergence, and decides the step to go back to and the lower rates.

It uses only steps and errors, not a clock, so decisions are the same on any machine and after a
resume. The error is the smoothed root mean squared error of each step's view: unlike the loss it
has no terms that fade in.
"""

import math
from typing import Any

from ...errors import GsError
from ..model.checkpoint_schema import as_float, as_int, as_measurements
from ..schedule.plan import Plan

MAX_RESCUES = 3
"""Most rescues; a further divergence ends the run with an error."""
SLOWER = 0.2
"""Factor of all learning rates per rescue."""
_WINDOW = 50
"""Steps over which errors are smoothed; the first ones only initialize the mean."""
_RATIO, _MARGIN = 1.7, 0.05
"""Bad: the error is above `_RATIO` times its best and `_MARGIN` above it (white against black: 1).
Healthy runs stay below 1.2 times, although photos become sharper during the run."""
_PATIENCE = 150
"""Diverged: bad for so many steps, or in the last one. Holes that a refinement leaves, where splats
before a plain background are split or removed, fill within a hundred."""
_SPOILT = 0.5
"""Diverged: more than this share of the last steps had no finite loss."""
_LOST = 0.5
"""Diverged: this share of the splats was reset as runaways."""
_FADES = 1000
"""Steps after which the weight of runaway splats has decayed to a third."""
_HEALTHY = 1.2
"""A state is kept while the error is at most this times its best."""
_GOOD_KEPT = 2


class Watchdog:
    """Divergence detector of one run, by its errors."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        """Plan of the trainer, which may change during the run."""
        self.rescues = 0
        """Number of rescues so far."""
        self._good: list[tuple[int, float]] = []  # step and best error by then
        self._begin(math.inf)

    @property
    def rate_factor(self) -> float:
        """Factor of all learning rates."""
        return SLOWER**self.rescues

    @property
    def good(self) -> tuple[int, ...]:
        """Steps with a good checkpoint, in ascending order."""
        return tuple(step for step, _ in self._good)

    def start(self, error: float) -> None:
        """Start a run with the error of its first splats and no good checkpoint."""
        self._good = []
        self._begin(error)

    def observe(self, step: int, mse: float, *, skipped: bool, lost: float = 0.0) -> bool:
        """Record a step; returns whether the run diverged.

        Args:
            step: The step just taken.
            mse: Mean squared error of its view.
            skipped: Whether its loss was not finite.
            lost: Share of the splats that were reset as runaways.
        """
        self._lost += lost - self._lost / _FADES
        self._spoilt += (float(skipped) - self._spoilt) / _WINDOW
        if not skipped and math.isfinite(mse):
            error = math.sqrt(max(mse, 0.0))
            self._count += 1
            weight = 1.0 / min(self._count, _WINDOW)
            self._error = (
                error if self._count == 1 else self._error + weight * (error - self._error)
            )
        if self.plan.resets_at(step):
            # Resets darken the rendered images; the statistics restart after the recovery.
            self._quiet_until = step + self.plan.reset_every // 2
            self._best = math.inf
        if self._spoilt > _SPOILT or self._lost > _LOST:
            return True
        if self._count < _WINDOW or step < self._quiet_until:
            return False
        self._best = min(self._best, self._error)
        bad = self._error > max(_RATIO * self._best, self._best + _MARGIN)
        self._bad = self._bad + 1 if bad else 0
        return self._bad >= _PATIENCE or (bad and step >= self.plan.iterations)

    def worth_keeping(self, step: int) -> bool:
        """Return whether the state after `step` should be kept as a good checkpoint."""
        if step % self.plan.kept_every or step < self._quiet_until or self._spoilt > 0.1:
            return False
        return self._count >= _WINDOW and self._error <= _HEALTHY * self._best

    def keep(self, step: int) -> None:
        """Record the checkpoint of `step`, which is about to be written, as good."""
        earlier = [entry for entry in self._good if entry[0] < step]
        self._good = [*earlier, (step, self._best)][-_GOOD_KEPT:]

    def rescue(self, step: int) -> int:
        """Return the step to go back to from `step`, and discard the statistics since then.

        A further divergence goes back further, unless a new good state was reached before.

        Raises:
            GsError: there is no good checkpoint, or there were too many rescues.
        """
        if self.rescues >= MAX_RESCUES or not self._good:
            again = f" again, after {self.rescues} rescues at lower rates" if self.rescues else ""
            sign = f"the image error was {self._error:.3g}, at best {self._best:.3g}"
            if self._lost > _LOST:
                sign = f"{self._lost:.0%} of the splats had runaway values"
            raise GsError(
                f"Training diverged{again}: at step {step} {sign}. Lower the learning rates "
                "(`--lr-boost 1`, `--means-lr`), and check that photos and cameras match. "
                "`--detect-anomaly` finds the first number that is not finite, `--no-watchdog` "
                "continues regardless."
            )
        self.rescues += 1
        back, best = self._good.pop() if len(self._good) > 1 else self._good[0]
        self._begin(best)
        return back

    def state(self) -> dict[str, Any]:
        """State for `restore`, as JSON values."""
        return {
            "rescues": self.rescues,
            "good": self._good,
            "error": self._error,
            "best": None if math.isinf(self._best) else self._best,
            "count": self._count,
            "bad": self._bad,
            "spoilt": self._spoilt,
            "lost": self._lost,
            "quiet_until": self._quiet_until,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Restore the values of `state`; ValueError or KeyError if they are invalid."""
        self.rescues = as_int("rescues", state["rescues"], high=MAX_RESCUES)
        self._good = as_measurements("good", state["good"])
        self._error, self._count = (
            as_float("error", state["error"]),
            as_int("count", state["count"]),
        )
        self._best = math.inf if state["best"] is None else as_float("best", state["best"])
        self._bad = as_int("bad", state.get("bad", 0))
        self._spoilt = as_float("spoilt", state["spoilt"])
        self._quiet_until = as_int("quiet_until", state["quiet_until"])
        self._lost = as_float("lost", state["lost"])

    def _begin(self, best: float) -> None:
        self._error, self._best, self._count, self._bad = 0.0, best, 0, 0
        self._lost = 0.0
        self._spoilt, self._quiet_until = 0.0, 0
