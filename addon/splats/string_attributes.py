"""String attributes of points in short steps, because Blender accesses them point by point."""

from typing import Any

import numpy as np

BLOCK = 1 << 12
"""Points per block, some milliseconds each."""


def read(mesh: Any, name: str, begin: int, values: np.ndarray, known: dict[bytes, bytes]) -> None:
    """Read a string attribute of `BLOCK` points from an index on.

    Args:
        mesh: Not in Edit Mode. Access to the first point copies shared memory in one call: 256 MB
            for a million splats, 0.05 to 0.7 s.
        name: Attribute name.
        begin: Index of the first point.
        values: [N, 1] of `point_attributes.empty_values`.
        known: Strings read before, extended; equal strings are stored once.
    """
    data = mesh.attributes[name].data
    # One by one, because the Python objects of a slice would trigger garbage collection.
    texts = (data[row].value for row in range(begin, min(begin + BLOCK, len(values))))
    values[begin : begin + BLOCK, 0] = [known.setdefault(text, text) for text in texts]


def write(mesh: Any, name: str, entries: np.ndarray) -> None:
    """Set strings of an existing attribute, from entries of `point_attributes.blocks`."""
    data = mesh.attributes[name].data
    for row, text in entries.tolist():
        data[row].value = text
