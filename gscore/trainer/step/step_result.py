"""Step result: measurements and changes of one training step."""

from collections.abc import Sequence
from typing import NamedTuple

from ..strategy import Change


class StepResult(NamedTuple):
    """What a step measured and did."""

    loss: float
    mse: float
    """Mean squared error of the view's pixels that count, before the step."""
    change: Change
    """What the strategy did."""
    bad_rows: int
    """Splats whose gradients were not finite and were left out."""
    skipped: bool
    """The loss was not finite or came from splats that ran away, so nothing was learnt."""
    lost_rows: int = 0
    """Splats that ran away and were taken out."""
    cleared_rows: int = 0
    """Splats that were taken out before a guide."""


def combine_results(results: Sequence[StepResult]) -> StepResult:
    """What the steps of all models measured and did."""
    count = len(results)
    if count == 1:
        return results[0]
    changes = [result.change for result in results]
    return StepResult(
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
