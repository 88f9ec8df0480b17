"""What can be handed to Blender bit by bit.

Apart, because `typing` remembers the classes that generic ones are made of until Python ends. If
one of them reached bpy through its module, bpy 4.5 would not be freed, and hang at the end.
"""

from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from .carried import Column


class Ready(Protocol):
    """Splats as Blender takes them."""

    @property
    def count(self) -> int:
        """How many."""
        ...

    @property
    def columns(self) -> tuple[tuple[str, str, np.ndarray], ...]:
        """As `attributes.columns`."""
        ...


ReadyT = TypeVar("ReadyT", bound=Ready)


@dataclass(frozen=True, kw_only=True, eq=False)
class Points:
    """Attributes of points, and nothing besides."""

    count: int
    """How many."""
    columns: tuple[tuple[str, str, np.ndarray], ...]
    """As `attributes.columns`."""


def points_of(table: list[Column]) -> Points:
    """The points of a table of at least one attribute."""
    columns = tuple((name, kind, values.reshape(-1)) for name, kind, values in table)
    return Points(count=len(table[0].values), columns=columns)
