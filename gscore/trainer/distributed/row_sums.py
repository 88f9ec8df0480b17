"""Row sums over ranks: sparse rows added in the order of the ranks.

Row i belongs to rank i modulo the number of ranks: that rank adds the values of all ranks, starting
with rank 0, so that the same ranks give the same bits, and sends the sum to all. Two ranks exchange
all their rows instead, which is no more traffic. Rows that no rank has are not sent.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ...raster.memory import zeros
from ...raster.row_packing import Table, pack_rows, unpack_rows, widths_of
from .process_group import ProcessGroup, ScratchBuffer


class SortedRows(NamedTuple):
    """Rows of a rank."""

    rows: Tensor
    """[M] int64; for more than two ranks, sorted by the rank that adds them."""
    sizes: list[int]
    """Number of rows sent to each rank."""


class RowSums:
    """Sums of sparse rows of large tables over ranks; keeps its memory between calls."""

    def __init__(self, group: ProcessGroup) -> None:
        self._group = group
        self._mine, self._given, self._sums, self._own, self._all = (
            ScratchBuffer() for _ in range(5)
        )

    def sorted(self, rows: Tensor) -> "SortedRows":
        """Sort this rank's rows, [M] int64 and unique, by the rank that adds them."""
        rank, size = self._group.rank, self._group.size
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
        all_sizes: np.ndarray | None = None,
        threads: int = 0,
    ) -> list[Tensor]:
        """Sum the rows over all ranks.

        Args:
            mine: Rows of this rank.
            tables: K numbers per row in total; tables with a divisor are divided by it first.
            all_sizes: [size, size] `sizes` of each rank, if known; None: the ranks exchange them.
            threads: 0: all cores.

        Returns:
            Parts, [R, 1 + K] int32, of rows that some rank has, in the format of
            `raster.row_packing.unpack_rows`: added in order they are the sums. Equal on all ranks,
            and valid until the next call.
        """
        group, size = self._group, self._group.size
        width = 1 + widths_of([table.data for table in tables])
        packed = self._mine.of(len(mine.rows), width)
        pack_rows(tables, mine.rows, packed, threads=threads)
        if size == 2:
            return group.rows(packed, self._given, all_sizes=all_sizes)
        given = group.all_to_all(packed, mine.sizes, self._given, all_sizes=all_sizes)
        places = [part[:, 0] // size for part in given]
        # Rows need not be sorted.
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
        own[:, 0] = at * size + group.rank
        return group.rows(own, self._all)
