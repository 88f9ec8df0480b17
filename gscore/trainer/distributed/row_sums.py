"""Row sums over ranks: sparse rows added in the order of the ranks.

Row i belongs to rank i modulo the number of ranks: it adds up what the ranks found for it, first
that of rank 0, so that the same ranks give the same bits, and gives the sum to all. Two ranks just
give each other all they have, which is no more. Rows that no rank has are not sent.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ...raster.memory import zeros
from ...raster.packing import Table, pack_rows, unpack_rows, widths_of
from .process_group import ProcessGroup
from .scratch_buffer import ScratchBuffer


class SortedRows(NamedTuple):
    """Rows of a rank."""

    rows: Tensor
    """[M] int64; for more than two ranks, first those that rank 0 adds up."""
    sizes: list[int]
    """How many each rank is given."""


class RowSums:
    """Adds up rows of large tables of which every rank has some; keeps its memory between calls."""

    def __init__(self, team: ProcessGroup) -> None:
        self._team = team
        self._mine, self._given, self._sums, self._own, self._all = (
            ScratchBuffer() for _ in range(5)
        )

    def sorted(self, rows: Tensor) -> "SortedRows":
        """The rows that this rank has, [M] int64, none twice, by those who add them up."""
        rank, size = self._team.rank, self._team.size
        if size == 2:
            return SortedRows(rows, [0 if other == rank else len(rows) for other in range(size)])
        owner = rows % size
        parts = [rows[owner == other] for other in range(size)]
        return SortedRows(torch.cat(parts), [len(part) for part in parts])

    def __call__(
        self,
        mine: "SortedRows",
        tables: Sequence[Table],
        *,
        told: np.ndarray | None = None,
        threads: int = 0,
    ) -> list[Tensor]:
        """Add up with all others.

        Args:
            mine: Which rows this rank has.
            tables: K numbers a row in all; those with a divisor are divided by it first.
            told: [size, size] `sizes` of what each rank has, where all know them already; None:
                the ranks meet for it.
            threads: 0: all cores.

        Returns:
            Pieces, [R, 1 + K] int32, of rows that some rank has, as `raster.packing.unpack_rows`
            takes them: added up one after the other they are the sums. Equal on all ranks, and good
            until the next call.
        """
        team, size = self._team, self._team.size
        width = 1 + widths_of([table.data for table in tables])
        packed = self._mine.of(len(mine.rows), width)
        pack_rows(tables, mine.rows, packed, threads=threads)
        if size == 2:
            return team.rows(packed, self._given, told=told)
        given = team.all_to_all(packed, mine.sizes, self._given, told=told)
        places = [part[:, 0] // size for part in given]
        # Rows need not ascend: the largest may stand anywhere.
        count = max((int(at.max()) + 1 for at in places if len(at)), default=0)
        sums = self._sums.of(count, width - 1).view(torch.float32).zero_()
        had = zeros(count, dtype=torch.bool)
        for at, part in zip(places, given, strict=True):
            part[:, 0] = at
            unpack_rows([Table(sums, adds=True)], part, threads=threads)
            had[at.to(torch.int64)] = True
        at = had.nonzero().flatten()
        own = self._own.of(len(at), width)
        pack_rows([Table(sums)], at, own, threads=threads)
        own[:, 0] = at * size + team.rank
        return team.rows(own, self._all)
