"""Step counts: steps taken, and what was skipped or reset in them so far."""

from collections.abc import Mapping
from typing import Any

from ...errors import GsError
from ...text_format import count_text
from ..model.checkpoint_schema import as_int
from .step_result import StepResult

_MAX_SKIPPED = 100


class StepCounts:
    """Counts of a training."""

    def __init__(self) -> None:
        self.steps = 0
        """Steps taken."""
        self.bad_rows = 0
        """Gradient rows skipped because they were not finite."""
        self.lost_rows = 0
        """Runaway splats reset, see `engine.cpu.sanitize`."""
        self.skipped = 0
        """Skipped steps in a row."""

    def note(self, result: StepResult) -> None:
        """Count the result of a step; GsError after many skipped ones in a row."""
        self.bad_rows += result.bad_rows
        self.lost_rows += result.lost_rows
        self.skipped = self.skipped + 1 if result.skipped else 0
        if self.skipped >= _MAX_SKIPPED:
            raise GsError(
                f"Training diverged: the loss was not finite for "
                f"{count_text(_MAX_SKIPPED, 'step')} in a row, the last one at step "
                f"{result.step}. Lower the learning rates; `--detect-anomaly` finds the first "
                "number that is not finite."
            )

    def state(self) -> dict[str, int]:
        """State for `restore`, as JSON values."""
        return dict(vars(self))

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore the values of `state`; ValueError or KeyError if they are invalid."""
        self.steps = as_int("steps", state["steps"])
        self.bad_rows = as_int("bad_rows", state["bad_rows"])
        self.lost_rows = as_int("lost_rows", state.get("lost_rows", 0))
        self.skipped = as_int("skipped", state["skipped"])
