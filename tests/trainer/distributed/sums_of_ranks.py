"""Run by several ranks: rows summed over the ranks, and in a plain loop in rank order."""

import itertools
import sys

import numpy as np
import torch

from gscore.raster.row_packing import Table, unpack_rows
from gscore.trainer.distributed.data_parallel import RowSums
from gscore.trainer.distributed.process_group import ProcessGroup

ROWS, WIDTH = 1000, 7
PARTS = slice(0, 3), slice(3, 4), slice(4, 7)
"""Columns of the tables that are added up together."""


def of_rank(rank: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows of a rank and their values; the last rank has none in the second round."""
    rng = np.random.default_rng(rank)
    rows = np.sort(rng.choice(ROWS, 300 + 50 * rank, replace=False))
    return rows, rng.normal(size=(len(rows), WIDTH)).astype(np.float32)


def main() -> int:
    """0: equal to the loop to the bit, also where one rank or all ranks have no rows."""
    with ProcessGroup() as group:
        sums_of = RowSums(group)
        silent_ones = (), (group.size - 1,), tuple(range(group.size))
        for silent, known in itertools.product(silent_ones, (False, True)):
            table, had = np.zeros((ROWS, WIDTH), np.float32), np.zeros(ROWS, bool)
            for rank in range(group.size):
                rows, values = of_rank(rank)
                if rank not in silent:
                    table[rows] += values
                    had[rows] = True
            rows, values = of_rank(group.rank)
            if group.rank in silent:
                rows, values = rows[:0], values[:0]
            mine = np.full((ROWS, WIDTH), np.nan, np.float32)  # unrequested rows are not read
            mine[rows] = values
            parts = [torch.from_numpy(np.ascontiguousarray(mine[:, at])) for at in PARTS]
            sums = [torch.zeros_like(part) for part in parts]
            found = np.zeros(ROWS, bool)
            have = sums_of.sorted(torch.from_numpy(rows))
            all_sizes = group.all_gather(have.sizes) if known else None
            for piece in sums_of(have, list(map(Table, parts)), all_sizes=all_sizes):
                unpack_rows([Table(sum_, adds=True) for sum_ in sums], piece)
                found[piece[:, 0].numpy()] = True
            assert (found == had).all()
            assert (torch.cat(sums, dim=1).numpy() == table).all()
    return 0


if __name__ == "__main__":
    sys.exit(main())
