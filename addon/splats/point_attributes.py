"""Point attributes as tables, splat or other: kept when points are deleted or joined; no bpy.

String attributes are copied in short steps, because Blender accesses them point by point.
"""

from collections.abc import Mapping
from itertools import takewhile
from typing import Any, NamedTuple

import numpy as np

from ..attributes import BASE, FORMATS, POSITION, ROTATION, SCALE, SELECTION, SH, SH_COUNTS
from ..process.incremental_tasks import Check

GROUP = "GROUP"
"""Data type of vertex group columns: weights; NaN: the splat is not in the group."""
TEXT = "STRING"
"""Data type of string columns: bytes."""
# Blender's own types; others are converted one by one, 0.1 s for a million splats.
_DTYPES = {
    "INT": np.int32,
    "BOOLEAN": np.bool_,
    "INT8": np.int8,
    "INT16_2D": np.int16,
    "INT32_2D": np.int32,
    TEXT: np.object_,
}
_HIDDEN = ".hide_vert"
GROUP_NAME = ".group:"
"""Prefix of group names in columns, to distinguish them from attribute names."""
_ENTRIES = np.dtype([("row", np.int32), ("weight", np.float32)])
_TEXTS = np.dtype([("row", np.int32), ("text", np.object_)])
_LACKING = {GROUP: np.nan, TEXT: b""}
"""Non-zero defaults of attributes that an object lacks."""
BLOCK = 1 << 12
"""Splats of a group or string attribute per block: a few milliseconds."""


class Column(NamedTuple):
    """One point attribute."""

    name: str
    kind: str
    """Data type."""
    values: np.ndarray
    """[N, width]"""


def kinds(mesh: Any, *, whole: bool = False) -> dict[str, str]:
    """Data types by name of all point attributes, of splats and others, that survive deleting and
    joining points.

    Args:
        mesh: Mesh or point cloud.
        whole: Also string attributes.

    Raises:
        ValueError: with `whole`, an attribute has a type of a later Blender and would be lost.
    """
    every = {
        a.name: a.data_type
        for a in mesh.attributes
        if a.domain == "POINT" and not a.name.startswith(".")
    }
    known = {name: kind for name, kind in every.items() if kind in FORMATS or kind == TEXT}
    if whole:
        if lost := [name for name in every if name not in known]:
            raise ValueError(
                f"The attribute {lost[0]} has the type {every[lost[0]]}, which this add-on cannot "
                "keep: convert or remove it first, under Object Data > Attributes."
            )
        return known
    return {name: kind for name, kind in known.items() if kind != TEXT}


def empty_values(kind: str, count: int) -> np.ndarray:
    """[N, width] uninitialised values for an attribute of a data type."""
    width = 1 if kind in _LACKING else FORMATS[kind][1]
    return np.empty((count, width), _DTYPES.get(kind, np.float32))


def zeroed(kinds: Mapping[str, str], count: int, check: Check = lambda: None) -> list[Column]:
    """Zero-filled columns by name and data type, for a thread; `check` raises after cancellation.

    The first write to an array allocates its memory pages. For the 12 MB of one attribute of a
    million splats this takes 10 to 70 ms; copying them takes 1 ms.
    """
    made = []
    for name, kind in kinds.items():
        check()
        made.append(Column(name, kind, empty_values(kind, count)))
        made[-1].values.fill(0)
    return made


def copy_values(mesh: Any, name: str, values: np.ndarray) -> None:
    """Copy a non-string attribute into an array of `empty_values`; not in Edit Mode."""
    attribute = mesh.attributes[name]
    attribute.data.foreach_get(FORMATS[attribute.data_type][0], values.reshape(-1))


def marks(mesh: Any) -> list[Column]:
    """Selection and hiding of a mesh of points, if any."""
    columns = []
    for name in (SELECTION, _HIDDEN):
        if name in mesh.attributes:
            values = empty_values("BOOLEAN", len(mesh.vertices))
            copy_values(mesh, name, values)
            columns.append(Column(name, "BOOLEAN", values))
    return columns


def blocks(column: Column) -> list[tuple[str, str, np.ndarray]]:
    """A vertex group or string column as blocks of splats, at least one: name without prefix, data
    type, and entries with `row` and `weight` or `text`, for splats that have one.

    Within a block of a group, splats are sorted by weight, because Blender sets equal weights in
    one call. The blocks are in the order of splats, because Blender allocates each separately and
    traverses all when it copies or frees a mesh.
    """
    values, made = column.values[:, 0], []
    grouped = column.kind == GROUP
    has = ~np.isnan(values) if grouped else values.astype(np.bool_)
    rows = np.flatnonzero(has).astype(np.int32)
    for at in range(0, len(rows) or 1, BLOCK):
        some = rows[at : at + BLOCK]
        if grouped:
            some = some[np.argsort(values[some], kind="stable")]
        entries = np.empty(len(some), _ENTRIES if grouped else _TEXTS)
        entries["row"], entries["weight" if grouped else "text"] = some, values[some]
        made.append((column.name.removeprefix(GROUP_NAME), column.kind, entries))
    return made


def of_splats(table: list[Column], *, rest: bool = True) -> dict[str, np.ndarray]:
    """The splat attributes of a table for `as_splats`, not copied; `rest` includes shN."""
    every = {column.name: column.values for column in table}
    harmonics = (f"{SH}{k}" for k in range(SH_COUNTS[-1] if rest else 0))
    names = [BASE, SCALE, ROTATION, POSITION, *takewhile(every.__contains__, harmonics)]
    return {name: every[name] for name in names if name in every}


def without_selection(table: list[Column]) -> list[Column]:
    """A table without the selection, for splats that move to another object."""
    return [column for column in table if column.name != SELECTION]


def picked(table: list[Column], rows: np.ndarray) -> list[Column]:
    """The rows [K] of a table."""
    return [Column(name, kind, values.take(rows, axis=0)) for name, kind, values in table]


def joined(tables: list[list[Column]]) -> list[Column]:
    """The points of several tables, concatenated; a missing attribute becomes 0 or an empty string,
    a missing vertex group has no members.

    Raises:
        ValueError: an attribute has two data types.
    """
    kinds: dict[str, str] = {}
    for name, kind, _ in (column for table in tables for column in table):
        if kinds.setdefault(name, kind) != kind:
            raise ValueError(f"The attribute {name} has another type in each object: rename one.")
    counts = [len(table[0].values) for table in tables]
    made = []
    for name, kind in kinds.items():
        values, at = empty_values(kind, sum(counts)), 0
        lacking = _LACKING.get(kind, 0)
        for table, count in zip(tables, counts, strict=True):
            own = next((c.values for c in table if c.name == name), lacking)
            values[at : at + count], at = own, at + count
        made.append(Column(name, kind, values))
    return made


def read_texts(
    mesh: Any, name: str, begin: int, values: np.ndarray, known: dict[bytes, bytes]
) -> None:
    """Read a string attribute of `BLOCK` points from an index on.

    Args:
        mesh: Not in Edit Mode. Access to the first point copies shared memory in one call: 256 MB
            for a million splats, 0.05 to 0.7 s.
        name: Attribute name.
        begin: Index of the first point.
        values: [N, 1] of `empty_values`.
        known: Strings read before, extended; equal strings are stored once.
    """
    data = mesh.attributes[name].data
    # One by one, because the Python objects of a slice would trigger garbage collection.
    texts = (data[row].value for row in range(begin, min(begin + BLOCK, len(values))))
    values[begin : begin + BLOCK, 0] = [known.setdefault(text, text) for text in texts]
