"""Samples of sequences and of directions."""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

Item = TypeVar("Item")


def evenly_spaced(items: Sequence[Item], most: int) -> list[Item]:
    """At most `most` items, evenly spaced from the first to the last; all if there are no more."""
    if len(items) <= most:
        return list(items)
    return [items[i] for i in np.linspace(0, len(items) - 1, most).round().astype(int).tolist()]


def sphere(count: int) -> np.ndarray:
    """Return [count, 3] evenly distributed unit vectors, on a spiral with the golden angle."""
    place = np.arange(count)
    z, turn = 1 - (2 * place + 1) / max(count, 1), place * np.pi * (3 - np.sqrt(5))
    across = np.sqrt(1 - z * z)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)
