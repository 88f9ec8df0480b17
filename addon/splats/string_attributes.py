"""String attributes of points in short steps, since Blender reads them point by point."""

from typing import Any

import numpy as np

BLOCK = 1 << 12
"""Points per block, some milliseconds each."""


def read(mesh: Any, name: str, begin: int, values: np.ndarray, known: dict[bytes, bytes]) -> None:
    """Read a string attribute of `BLOCK` points from an index on.

    Args:
        mesh: Not in Edit Mode. One that shares memory with another gets its own with the first of
            its points, in one call: of a million splats 256 MB, 0.05 to 0.7 s.
        name: Of the attribute.
        begin: The first of the points.
        values: [N, 1], what `carried.empty_values` made.
        known: All that was read before, and then this: what is alike is kept once.
    """
    data = mesh.attributes[name].data
    # One by one: as many Python objects at once as a slice has would start garbage collection.
    found = (data[row].value for row in range(begin, min(begin + BLOCK, len(values))))
    values[begin : begin + BLOCK, 0] = [known.setdefault(text, text) for text in found]


def write(mesh: Any, name: str, entries: np.ndarray) -> None:
    """Set those of some points, given as `carried.blocks` gives them; the attribute is there."""
    data = mesh.attributes[name].data
    for row, text in entries.tolist():
        data[row].value = text
