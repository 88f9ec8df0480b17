"""Sums over ranks of rows that few of them have, in the order of the ranks.

Row i belongs to rank i modulo the number of ranks: it adds up what the ranks found for it, first
that of rank 0, so that the same ranks give the same bits, and gives the sum to all. Two ranks just
give each other all they have, which is no more. Rows that no rank has are not sent.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from ...raster.memory import zeros
from ...raster.packing import Table, pack_rows, unpack_rows, widths_of
from .room import Room
from .team import Team


class RowSums:
    """Adds up rows of large tables of which every rank has some; keeps its memory between calls."""

    def __init__(self, team: Team) -> None:
        self._team = team
        self._mine, self._given, self._sums, self._own, self._all = (Room() for _ in range(5))

    def __call__(self, rows: Tensor, tables: Sequence[Tensor], *, threads: int = 0) -> list[Tensor]:
        """Add up with all others.

        Args:
            rows: [M] int64: which rows this rank has, none twice.
            tables: [N, ...] float32 each, contiguous: K numbers a row in all.
            threads: 0: all cores.

        Returns:
            Pieces, [R, 1 + K] int32, of rows that some rank has, as `raster.packing.unpack_rows`
            takes them: added up one after the other they are the sums. Equal on all ranks, and good
            until the next call.
        """
        team, size = self._team, self._team.size
        width = 1 + widths_of(tables)
        if size == 2:
            packed = self._mine.of(len(rows), width)
            pack_rows([Table(t) for t in tables], rows, packed, threads=threads)
            return team.rows(packed, self._given)
        owner = rows % size
        mine = [rows[owner == rank] for rank in range(size)]
        packed = self._mine.of(len(rows), width)
        pack_rows([Table(t) for t in tables], torch.cat(mine), packed, threads=threads)
        given = team.swap(packed, [len(part) for part in mine], self._given)
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
