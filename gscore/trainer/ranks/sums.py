"""Sums over ranks of rows that few of them have, in the order of the ranks.

Row i belongs to rank i modulo the number of ranks: it adds up what the ranks found for it, first
that of rank 0, so that the same ranks give the same bits, and gives the sum to all. Rows that no
rank has are not sent.
"""

import torch
from torch import Tensor

from ...raster.memory import zeros
from .team import Team


def sum_rows(team: Team, rows: Tensor, values: Tensor) -> tuple[Tensor, Tensor]:
    """Add up rows of a large table of which every rank has some.

    Args:
        team: All take part.
        rows: [M] int64, ascending: which rows this rank has.
        values: [M, K] float32.

    Returns:
        Rows that some rank has, [R] int64, and their sums, [R, K] float32; equal on all ranks.
    """
    size = team.size
    packed = torch.cat([rows.to(torch.int32)[:, None], values.view(torch.int32)], dim=1)
    owner = rows % size
    given = team.swap([packed[owner == rank] for rank in range(size)])
    places = [part[:, 0].to(torch.int64) // size for part in given]
    count = max((int(at[-1]) + 1 for at in places if len(at)), default=0)
    sums = zeros(count, values.shape[1])
    had = zeros(count, dtype=torch.bool)
    for at, part in zip(places, given, strict=True):
        sums[at] += _floats(part)
        had[at] = True
    at = had.nonzero().flatten()
    own = (at * size + team.rank).to(torch.int32)
    found = team.rows(torch.cat([own[:, None], sums[at].view(torch.int32)], dim=1))
    table = torch.cat(found)
    return table[:, 0].to(torch.int64), _floats(table)


def _floats(packed: Tensor) -> Tensor:
    return packed[:, 1:].contiguous().view(torch.float32)
