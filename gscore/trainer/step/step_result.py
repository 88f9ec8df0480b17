"""Step result: measurements and changes of one training step, and their counts so far."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from ...engine.base import StepNumbers
from ...errors import GsError
from ...text_format import count_text
from ..model.checkpoint_schema import as_int
from ..strategy import Change


class StepResult(NamedTuple):
    """Measurements and changes of a step."""

    step: int
    """Number of the step, from 1."""
    photos: int
    """Number of photos in its batch."""
    loss: float
    mse: float
    """Mean squared error of the view's unmasked pixels, before the step."""
    change: Change
    """Changes by the strategy."""
    bad_rows: int
    """Number of splats with gradients that were not finite, which were ignored."""
    skipped: bool
    """True if the update was skipped, because the loss was not finite or came from runaways."""
    lost_rows: int = 0
    """Number of runaway splats that were reset."""


def result_of(numbers: StepNumbers, photos: int) -> StepResult:
    """Return the result of a step of one model on a batch of `photos`, before its edits."""
    return StepResult(
        step=numbers.step,
        photos=photos,
        loss=numbers.loss,
        mse=numbers.mse,
        change=Change(),
        bad_rows=numbers.bad_rows,
        skipped=numbers.skipped,
        lost_rows=numbers.lost_rows,
    )


def combine_results(results: Sequence[StepResult]) -> StepResult:
    """Combine the results of all models: means of the losses, sums of the changes."""
    count = len(results)
    if count == 1:
        return results[0]
    return StepResult(
        step=results[0].step,
        photos=results[0].photos,
        loss=sum(result.loss for result in results) / count,
        mse=sum(result.mse for result in results) / count,
        change=sum((result.change for result in results), start=Change()),
        bad_rows=sum(result.bad_rows for result in results),
        skipped=any(result.skipped for result in results),
        lost_rows=sum(result.lost_rows for result in results),
    )


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
