"""Row packing: rows of several tables in one buffer, natively on torch tensors, for transfers."""

import ctypes as ct
import math
from collections.abc import Sequence
from typing import NamedTuple

from torch import Tensor

from . import _native, arguments, header
from .buffers import INT32, INT64, address, optional


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
    status = _native.library().gs_pack_rows(
        *_tables(tables),
        address("rows", rows, (len(packed),), INT64),
        _packed(tables, packed),
        len(packed),
        arguments.library_threads(threads),
    )
    _native.raise_status(status)


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
    status = _native.library().gs_unpack_rows(
        *_tables(tables),
        _packed(tables, packed),
        optional("marks", marks, (len(tables[0].data),), INT32),
        len(packed),
        arguments.library_threads(threads),
    )
    _native.raise_status(status)


def _tables(tables: Sequence[Table]) -> tuple[ct.Array[ct.Structure], int, int]:
    """gs_row_table of each table, their number, and that of their rows."""
    count, structs = len(tables[0].data), (header.RowTableStruct * len(tables))()
    for i, (data, adds, divisor) in enumerate(tables):
        place = address("table", data, (count, *data.shape[1:]))
        structs[i] = header.RowTableStruct(place, _width(data), adds, divisor)
    return structs, len(tables), count


def _packed(tables: Sequence[Table], packed: Tensor) -> int:
    shape = (len(packed), 1 + widths_of([table.data for table in tables]))
    return address("packed", packed, shape, INT32)


def _width(data: Tensor) -> int:
    return math.prod(data.shape[1:])
