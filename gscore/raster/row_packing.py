"""Row packing: rows of several tables in one buffer, natively on torch tensors, for transfers."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from torch import Tensor

from . import _native, header
from .buffers import address


class Table(NamedTuple):
    """Values of N rows, and their treatment."""

    data: Tensor
    """[N, ...] float32, contiguous, CPU."""
    adds: bool = False
    """`unpack_rows` adds to the present values; else it replaces them."""
    divisor: float = 1.0
    """`pack_rows` divides the rows by this, in the table itself, before it copies them."""


def widths_of(tables: Sequence[Tensor]) -> int:
    """Total number of values per row over all tables."""
    return sum(map(_width, tables))


def pack_rows(tables: Sequence[Table], rows: Tensor, packed: Tensor, *, threads: int = 0) -> None:
    """Copy rows of all tables into one buffer.

    Args:
        tables: At least one, of the same N rows each.
        rows: [M] int64, contiguous, 0 to N - 1, without duplicates.
        packed: [M, 1 + K] int32, contiguous; receives the number of the row, then the bits of its K
            values, table by table.
        threads: 0: all cores; results do not depend on it.

    Raises:
        ShapeError: a tensor has a wrong dtype or layout, before any change; or a row is out of
            range, and was skipped.
    """
    structs, count = _structs(tables)
    _native.pack_rows(structs, count, rows, packed, threads)


def unpack_rows(
    tables: Sequence[Table], packed: Tensor, *, marks: Tensor | None = None, threads: int = 0
) -> None:
    """Write packed rows into tables of the same widths.

    Args:
        tables: As for `pack_rows`, changed in place.
        packed: [M, 1 + K] int32, contiguous, without duplicate rows.
        marks: [N] int32, contiguous, set to 1 for each of the rows; None: no marks.
        threads: 0: all cores; results do not depend on it.

    Raises:
        ShapeError: a tensor has a wrong dtype or layout, before any change; or a row is out of
            range, and was skipped.
    """
    structs, count = _structs(tables)
    _native.unpack_rows(structs, count, packed, marks, threads)


def _structs(tables: Sequence[Table]) -> tuple[list[header.RowTableStruct], int]:
    count = len(tables[0].data)
    structs = []
    for data, adds, divisor in tables:
        place = address("table", data, (count, *data.shape[1:]))
        structs.append(header.RowTableStruct(place, _width(data), adds, divisor))
    return structs, count


def _width(data: Tensor) -> int:
    return math.prod(data.shape[1:])
