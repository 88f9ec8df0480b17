"""Batch losses: exchanged between ranks and checked before any parameter changes."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...errors import DatasetError, GsError
from .process_group import ProcessGroup


def fail(team: ProcessGroup, error: GsError) -> None:
    """Tell the others that this rank's photo cannot be had."""
    _told(team, [1.0, 0.0, 0.0, 0.0, 0.0], [0] * team.size)
    team.texts(str(error))
    team.told = True


class BatchLosses(NamedTuple):
    """What all ranks know of a batch."""

    values: list[float]
    """The loss of each photo, in the order of the ranks."""
    errors: list[float]
    """Their mean squared errors."""
    costs: list[float]
    """What drawing them took."""
    sizes: np.ndarray
    """[size, size] the `sizes` of each rank."""


def of_all(
    team: ProcessGroup,
    value: float,
    mse: float,
    *,
    cost: float,
    photos: int,
    mark: float,
    sizes: Sequence[int],
) -> BatchLosses:
    """Compare what the ranks found in their photos of a batch.

    Args:
        team: All take part.
        value: The loss of this rank's photo.
        mse: Its mean squared error.
        cost: What drawing it took, in any unit; the same whoever draws it.
        photos: How many there are in this batch.
        mark: A number that must be the same on all ranks.
        sizes: How many rows of gradients this rank will give each rank.

    Raises:
        DatasetError: a rank cannot have its photo, see `fail`.
        GsError: the marks differ.
    """
    found, told = _told(team, [0.0, value, mse, cost, mark], sizes)
    missing, values, errors, costs, marks = found.T
    if missing.any():
        rank, texts = int(missing.argmax()), team.texts("")
        team.told = True
        raise DatasetError(f"Rank {rank}: {texts[rank]}")
    if (marks != mark).any() or (marks != marks[0]).any():
        rank = int((marks != marks[0]).argmax())
        team.told = True
        raise GsError(
            f"Rank {rank} has other splats than rank 0, after the same steps: its machine computes "
            "otherwise. Start again with --resume on machines of one kind, or with GSCORE_ISA and "
            "ATEN_CPU_CAPABILITY set to what all have."
        )
    return BatchLosses(
        values=values[:photos].tolist(),
        errors=errors[:photos].tolist(),
        costs=costs[:photos].tolist(),
        sizes=told,
    )


def _told(
    team: ProcessGroup, mine: Sequence[float], sizes: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Of each rank [size, 5] `mine` and [size, size] `sizes`; the team keeps their accounts."""
    found = team.all_gather([*mine, *sizes, *team.account])
    told, sized, team.accounts = np.split(found, [len(mine), len(mine) + team.size], axis=1)
    return told, sized
