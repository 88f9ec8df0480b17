"""Batch losses: exchanged between ranks and checked before any parameter changes."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...errors import DatasetError, GsError
from .process_group import ProcessGroup


class OtherRankError(DatasetError):
    """Another rank cannot read its photo; all ranks raise an error in this step."""


def fail(group: ProcessGroup, error: GsError) -> None:
    """Notify the other ranks that this rank cannot read its photo."""
    _gather(group, [1.0, 0.0, 0.0, 0.0, 0.0], [0] * group.size)
    group.texts(str(error))
    group.notified = True


class BatchLosses(NamedTuple):
    """Losses and costs of a batch, equal on all ranks."""

    values: list[float]
    """The loss of each photo, in the order of the ranks."""
    errors: list[float]
    """Mean squared errors of the photos."""
    costs: list[float]
    """Rendering costs."""
    sizes: np.ndarray
    """[size, size] the `sizes` of each rank."""


def of_all(
    group: ProcessGroup,
    value: float,
    mse: float,
    *,
    cost: float,
    photos: int,
    mark: float,
    sizes: Sequence[int],
) -> BatchLosses:
    """Exchange the losses of a batch between ranks.

    Args:
        group: Process group; all ranks must call this.
        value: The loss of this rank's photo.
        mse: Its mean squared error.
        cost: Rendering cost in any unit, equal on any machine.
        photos: Number of photos in this batch.
        mark: A number that must be the same on all ranks.
        sizes: Rows of gradients that this rank will send to each rank.

    Raises:
        OtherRankError: a rank cannot read its photo (`fail`).
        GsError: the marks differ.
    """
    found, all_sizes = _gather(group, [0.0, value, mse, cost, mark], sizes)
    missing, values, errors, costs, marks = found.T
    if missing.any():
        rank, texts = int(missing.argmax()), group.texts("")
        group.notified = True
        raise OtherRankError(f"Rank {rank}: {texts[rank]}")
    if (marks != mark).any() or (marks != marks[0]).any():
        rank = int((marks != marks[0]).argmax())
        group.notified = True
        raise GsError(
            f"Rank {rank} has other splats than rank 0 after the same steps, because its machine "
            "computes differently. Resume with `--resume` on machines of one kind, or with "
            "GSCORE_ISA and ATEN_CPU_CAPABILITY set to what all support."
        )
    return BatchLosses(
        values=values[:photos].tolist(),
        errors=errors[:photos].tolist(),
        costs=costs[:photos].tolist(),
        sizes=all_sizes,
    )


def _gather(
    group: ProcessGroup, mine: Sequence[float], sizes: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Gather [size, 5] `mine` and [size, size] `sizes` of all ranks; updates `group.accounts`."""
    found = group.all_gather([*mine, *sizes, *group.account])
    values, sized, group.accounts = np.split(found, [len(mine), len(mine) + group.size], axis=1)
    return values, sized
