"""Point attributes as tables, splat or other: kept when points are deleted or joined; no bpy."""

from itertools import takewhile
from typing import Any, NamedTuple

import numpy as np

from ..attributes import BASE, FORMATS, POSITION, ROTATION, SCALE, SELECTION, SH, SH_COUNTS

GROUP = "GROUP"
"""Data type of columns of vertex groups: the weights of splats that are in one; NaN: it is not."""
TEXT = "STRING"
"""Data type of string columns: bytes."""
# As Blender keeps them: others it takes number by number, of a million splats in 0.1 s.
_DTYPES = {
    "INT": np.int32,
    "BOOLEAN": np.bool_,
    "INT8": np.int8,
    "INT16_2D": np.int16,
    "INT32_2D": np.int32,
    TEXT: np.object_,
}
_HIDDEN = ".hide_vert"
_GROUP_NAME = ".group:"
"""Prefix of group names, to tell them from attribute names among columns."""
_ENTRIES = np.dtype([("row", np.int32), ("weight", np.float32)])
_TEXTS = np.dtype([("row", np.int32), ("text", np.object_)])
_LACKING = {GROUP: np.nan, TEXT: b""}
"""Non-zero defaults of attributes that an object lacks."""
_BLOCK = 1 << 12
"""Splats of a group or string attribute per block: a few milliseconds."""


class Column(NamedTuple):
    """One attribute of points."""

    name: str
    kind: str
    """Its data type."""
    values: np.ndarray
    """[N, width]"""


def kinds(mesh: Any, *, whole: bool = False) -> dict[str, str]:
    """Data types by name of all attributes of points of numbers and vectors, those of others among
    them: what follows where points are deleted or joined.

    Args:
        mesh: Or point cloud.
        whole: Text too, which is all that Blender has.

    Raises:
        ValueError: `whole`, and there is one of a later Blender's types, which would be lost.
    """
    found = {
        a.name: a.data_type
        for a in mesh.attributes
        if a.domain == "POINT" and not a.name.startswith(".")
    }
    known = {name: kind for name, kind in found.items() if kind in FORMATS or kind == TEXT}
    if whole:
        if lost := [name for name in found if name not in known]:
            raise ValueError(
                f"The attribute {lost[0]} is of a type that this add-on cannot keep, "
                f"{found[lost[0]]}: convert or remove it first, under Object Data > Attributes."
            )
        return known
    return {name: kind for name, kind in known.items() if kind != TEXT}


def empty_values(kind: str, count: int) -> np.ndarray:
    """[N, width] for an attribute of this data type, not yet set."""
    width = 1 if kind in _LACKING else FORMATS[kind][1]
    return np.empty((count, width), _DTYPES.get(kind, np.float32))


def copy_values(mesh: Any, name: str, values: np.ndarray) -> None:
    """Copy an attribute, which is no text, into what `empty_values` made; the mesh is not in Edit
    Mode."""
    attribute = mesh.attributes[name]
    attribute.data.foreach_get(FORMATS[attribute.data_type][0], values.reshape(-1))


def marks(mesh: Any) -> list[Column]:
    """Selection and hiding of a mesh of points, if any."""
    found = []
    for name in (SELECTION, _HIDDEN):
        if name in mesh.attributes:
            values = empty_values("BOOLEAN", len(mesh.vertices))
            copy_values(mesh, name, values)
            found.append(Column(name, "BOOLEAN", values))
    return found


def of_groups(names: list[str], weights: np.ndarray) -> list[Column]:
    """A column for each vertex group, of [G, N] float32."""
    return [
        Column(f"{_GROUP_NAME}{name}", GROUP, values[:, None])
        for name, values in zip(names, weights, strict=True)
    ]


def blocks(column: Column) -> list[tuple[str, str, np.ndarray]]:
    """What is handed over some splats at a time: name, data type, and numbers `row` and weights
    `weight` of those in a vertex group, which goes by its own name, or texts `text` of those that
    have one; at least one such block.

    Within each of a group, splats of the same weight are side by side, which so are handed over at
    once. The blocks are in the order of splats: Blender gives each memory of its own, and goes
    through all of it when it copies or frees a mesh.
    """
    values, found = column.values[:, 0], []
    grouped = column.kind == GROUP
    has = ~np.isnan(values) if grouped else values.astype(np.bool_)
    rows = np.flatnonzero(has).astype(np.int32)
    for at in range(0, len(rows) or 1, _BLOCK):
        some = rows[at : at + _BLOCK]
        if grouped:
            some = some[np.argsort(values[some], kind="stable")]
        entries = np.empty(len(some), _ENTRIES if grouped else _TEXTS)
        entries["row"], entries["weight" if grouped else "text"] = some, values[some]
        found.append((column.name.removeprefix(_GROUP_NAME), column.kind, entries))
    return found


def of_splats(table: list[Column], *, rest: bool = True) -> dict[str, np.ndarray]:
    """The splat attributes of a table for `as_splats`, not copied; `rest` as in `read`."""
    found = {column.name: column.values for column in table}
    harmonics = (f"{SH}{k}" for k in range(SH_COUNTS[-1] if rest else 0))
    wanted = [BASE, SCALE, ROTATION, POSITION, *takewhile(found.__contains__, harmonics)]
    return {name: found[name] for name in wanted if name in found}


def without_selection(table: list[Column]) -> list[Column]:
    """A table but for what is selected, of which a part of its splats becomes a part of others."""
    return [column for column in table if column.name != SELECTION]


def picked(table: list[Column], rows: np.ndarray) -> list[Column]:
    """The rows [K] of a table."""
    return [Column(name, kind, values.take(rows, axis=0)) for name, kind, values in table]


def joined(tables: list[list[Column]]) -> list[Column]:
    """The points of some tables, one after the other; 0, or no text, where one lacks an attribute,
    and none in a vertex group that it lacks.

    Raises:
        ValueError: an attribute has two data types.
    """
    found: dict[str, str] = {}
    for name, kind, _ in (column for table in tables for column in table):
        if found.setdefault(name, kind) != kind:
            raise ValueError(f"The attribute {name} has another type in each object: rename one.")
    counts = [len(table[0].values) for table in tables]
    made = []
    for name, kind in found.items():
        values, at = empty_values(kind, sum(counts)), 0
        lacking = _LACKING.get(kind, 0)
        for table, count in zip(tables, counts, strict=True):
            own = next((c.values for c in table if c.name == name), lacking)
            values[at : at + count], at = own, at + count
        made.append(Column(name, kind, values))
    return made
