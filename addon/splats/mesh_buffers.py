"""Mesh buffers: arrays that are written to Blender in short steps.

A separate module, because `typing` caches the arguments of generic classes until Python ends. If
one of them referred to bpy through its module, bpy 4.5 would not be freed and would hang at exit.
"""

from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from .point_attributes import GROUP, TEXT, Column, blocks


class MeshBuffers(Protocol):
    """Splats in the form of Blender's attributes."""

    @property
    def count(self) -> int:
        """Number of splats."""
        ...

    @property
    def columns(self) -> tuple[tuple[str, str, np.ndarray], ...]:
        """Columns like `attributes.columns`, with groups and text of `point_attributes.blocks`."""
        ...


ReadyT = TypeVar("ReadyT", bound=MeshBuffers)


@dataclass(frozen=True, kw_only=True, eq=False)
class Points:
    """Attributes of points only."""

    count: int
    """Number of points."""
    columns: tuple[tuple[str, str, np.ndarray], ...]
    """Attributes like `MeshBuffers.columns`."""


def points_of(table: list[Column]) -> Points:
    """The points of a table of at least one attribute; sorts the weights of vertex groups."""
    groups = [column for column in table if column.kind == GROUP]
    columns = []
    for column in table:
        if column.kind == TEXT:
            columns += blocks(column)
        elif column.kind != GROUP:
            columns.append((column.name, column.kind, column.values.reshape(-1)))
    # After all attributes: Blender creates no attribute with the name of a group.
    columns += [block for column in groups for block in blocks(column)]
    return Points(count=len(table[0].values), columns=tuple(columns))
