"""Step result: measurements and changes of one training step."""

from collections.abc import Sequence
from typing import NamedTuple

from ...engine.base import StepNumbers
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
    cleared_rows: int = 0
    """Number of splats that were removed in front of a guide mesh."""


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
    changes = [result.change for result in results]
    return StepResult(
        step=results[0].step,
        photos=results[0].photos,
        loss=sum(result.loss for result in results) / count,
        mse=sum(result.mse for result in results) / count,
        change=Change(
            added=sum(change.added for change in changes),
            removed=sum(change.removed for change in changes),
            moved=sum(change.moved for change in changes),
            reset=any(change.reset for change in changes),
        ),
        bad_rows=sum(result.bad_rows for result in results),
        skipped=any(result.skipped for result in results),
        lost_rows=sum(result.lost_rows for result in results),
    )
