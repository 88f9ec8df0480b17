"""Rows of several tables packed side by side, and back; oracle: numpy's indexing."""

import numpy as np
import pytest
import torch

from gscore.errors import ShapeError
from gscore.raster.row_packing import Table, pack_rows, unpack_rows, widths_of

SHAPES = ((500, 3), (500,), (500, 8, 3))


def tables(seed: int) -> list[torch.Tensor]:
    """Random tables of 500 rows, 28 numbers each."""
    generator = torch.Generator().manual_seed(seed)
    return [torch.randn(shape, generator=generator) for shape in SHAPES]


def packed_of(parts: list[torch.Tensor], rows: np.ndarray, divisor: float = 1) -> torch.Tensor:
    """These rows of the tables; those of the last one are divided."""
    packed = torch.empty(len(rows), 1 + widths_of(parts), dtype=torch.int32)
    divided = [*map(Table, parts[:-1]), Table(parts[-1], divisor=divisor)]
    pack_rows(divided, torch.from_numpy(rows), packed)
    return packed


@pytest.mark.parametrize("threads", [1, 3])
def test_rows_are_divided_copied_and_added(threads: int) -> None:
    """Oracle: numpy's indexing, to the bit; rows that were not packed are unchanged."""
    rows = np.random.default_rng(0).permutation(500)[:200]
    there, mine = tables(1), tables(0)
    thirds = mine[2].numpy().copy()
    thirds[rows] /= np.float32(3)
    expected = [part.numpy().copy() for part in there]
    expected[0][rows] = mine[0].numpy()[rows]
    expected[1][rows] += mine[1].numpy()[rows]
    expected[2][rows] = thirds[rows]
    packed = packed_of(mine, rows, divisor=3)
    assert (packed[:, 0].numpy() == rows).all()
    assert (mine[2].numpy() == thirds).all()
    marks = torch.zeros(500, dtype=torch.int32)
    marks[7] = 5
    into = [Table(there[0]), Table(there[1], adds=True), Table(there[2])]
    unpack_rows(into, packed, marks=marks, threads=threads)
    for found, wanted in zip(there, expected, strict=True):
        assert (found.numpy() == wanted).all()
    wanted = np.isin(np.arange(500), rows).astype(int)
    wanted[7] = wanted[7] or 5
    assert (marks.numpy() == wanted).all()


def test_no_rows_and_no_tables_of_rows_are_fine() -> None:
    """Oracle: equal bits."""
    there = tables(1)
    unpack_rows([Table(part) for part in there], packed_of(tables(0), np.zeros(0, np.int64)))
    for found, before in zip(there, tables(1), strict=True):
        assert (found == before).all()
    empty = torch.zeros(0, 4)
    assert packed_of([empty], np.zeros(0, np.int64)).shape == (0, 5)


@pytest.mark.parametrize("row", [-1, 500])
def test_rows_that_are_none_are_refused(row: int) -> None:
    """Oracle: the error, and unchanged tables but for the other rows."""
    there = tables(1)
    packed = packed_of(tables(0), np.arange(7))
    packed[5, 0] = row
    with pytest.raises(ShapeError, match="row 5 has a row index"):
        unpack_rows([Table(part) for part in there], packed)
    for found, before, given in zip(there, tables(1), tables(0), strict=True):
        assert (found[[5, *range(7, 500)]] == before[[5, *range(7, 500)]]).all()
        assert (found[[0, 1, 2, 3, 4, 6]] == given[[0, 1, 2, 3, 4, 6]]).all()
    with pytest.raises(ShapeError, match="row 1 has a row index"):
        packed_of(tables(0), np.array([3, row, 4]))


def test_tables_that_are_none_are_refused() -> None:
    """Oracle: the error, which names the expected table."""
    packed = torch.zeros(2, 4, dtype=torch.int32)
    with pytest.raises(ShapeError, match="contiguous"):
        unpack_rows([Table(torch.zeros(3, 9).T)], packed)
    with pytest.raises(ShapeError, match="float32"):
        unpack_rows([Table(torch.zeros(9, 3, dtype=torch.float64))], packed)
    with pytest.raises(ShapeError, match="packed"):
        unpack_rows([Table(torch.zeros(9, 4))], packed)
    with pytest.raises(ShapeError, match="rows must be"):
        pack_rows([Table(torch.zeros(9, 3))], torch.zeros(2, dtype=torch.int32), packed)
    with pytest.raises(ShapeError, match="marks must be"):
        unpack_rows([Table(torch.zeros(9, 3))], packed, marks=torch.zeros(8, dtype=torch.int32))
