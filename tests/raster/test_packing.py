"""Rows of several tables side by side in one, and back; oracle: numpy's indexing."""

import numpy as np
import pytest
import torch

from gscore.errors import ShapeError
from gscore.raster.packing import Table, pack_rows, unpack_rows, widths_of

SHAPES = ((500, 3), (500,), (500, 8, 3))


def tables(seed: int) -> list[torch.Tensor]:
    """Of 500 rows, 28 numbers each."""
    generator = torch.Generator().manual_seed(seed)
    return [torch.randn(shape, generator=generator) for shape in SHAPES]


def packed_of(parts: list[torch.Tensor], rows: np.ndarray) -> torch.Tensor:
    """These rows of the tables."""
    packed = torch.empty(len(rows), 1 + widths_of(parts), dtype=torch.int32)
    pack_rows([Table(part) for part in parts], torch.from_numpy(rows), packed)
    return packed


@pytest.mark.parametrize("threads", [1, 3])
def test_rows_are_copied_added_and_divided(threads: int) -> None:
    """Oracle: numpy's indexing, to the bit; rows that were not packed stay as they are."""
    rows = np.random.default_rng(0).permutation(500)[:200]
    there, mine = tables(1), tables(0)
    expected = [part.numpy().copy() for part in there]
    expected[0][rows] = mine[0].numpy()[rows]
    expected[1][rows] += mine[1].numpy()[rows]
    expected[2][rows] = mine[2].numpy()[rows] / np.float32(3)
    packed = packed_of(mine, rows)
    assert (packed[:, 0].numpy() == rows).all()
    into = [Table(there[0]), Table(there[1], adds=True), Table(there[2], divisor=3)]
    unpack_rows(into, packed, threads=threads)
    for found, wanted in zip(there, expected, strict=True):
        assert (found.numpy() == wanted).all()


def test_no_rows_and_no_tables_of_rows_are_fine() -> None:
    """Oracle: nothing changes."""
    there = tables(1)
    unpack_rows([Table(part) for part in there], packed_of(tables(0), np.zeros(0, np.int64)))
    for found, before in zip(there, tables(1), strict=True):
        assert (found == before).all()
    empty = torch.zeros(0, 4)
    assert packed_of([empty], np.zeros(0, np.int64)).shape == (0, 5)


@pytest.mark.parametrize("row", [-1, 500])
def test_rows_that_are_none_are_refused(row: int) -> None:
    """Oracle: the error, and tables that are as they were."""
    there = tables(1)
    packed = packed_of(tables(0), np.arange(7))
    packed[5, 0] = row
    with pytest.raises(ShapeError, match="row 5 is for no row"):
        unpack_rows([Table(part) for part in there], packed)
    for found, before in zip(there, tables(1), strict=True):
        assert (found == before).all()


def test_tables_that_are_none_are_refused() -> None:
    """Oracle: the error names what was expected."""
    packed = torch.zeros(2, 4, dtype=torch.int32)
    with pytest.raises(ShapeError, match="contiguous"):
        unpack_rows([Table(torch.zeros(3, 9).T)], packed)
    with pytest.raises(ShapeError, match="float32"):
        unpack_rows([Table(torch.zeros(9, 3, dtype=torch.float64))], packed)
    with pytest.raises(ShapeError, match="packed"):
        unpack_rows([Table(torch.zeros(9, 4))], packed)
