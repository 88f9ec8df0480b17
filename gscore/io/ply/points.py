"""PLY point clouds without splat parameters."""

from pathlib import Path

import numpy as np

from ...errors import FormatError
from ...scene import PointCloud
from .elements import read_elements

_BLOCK = 1 << 16
"""Points converted at a time."""


def read_point_cloud(path: str | Path) -> PointCloud:
    """Positions and colours of the vertices of any PLY file; black if it has no colours.

    Raises:
        DatasetError: the file is missing.
        FormatError: it is truncated or corrupt, or has no vertices with x, y, z.
    """
    path = Path(path)
    table = read_elements(path).get("vertex", np.zeros(0, [("none", "f4")]))
    names = table.dtype.names or ()
    missing = [name for name in "xyz" if name not in names or table.dtype[name].kind == "O"]
    if missing:
        raise FormatError(
            f"{path} has no points: its vertices lack {', '.join(missing)}. Export it again."
        )
    points = np.empty((len(table), 3))
    colors = np.zeros((len(table), 3), np.uint8)
    rgb = ("red", "green", "blue")
    colored = all(name in names and table.dtype[name].kind in "iuf" for name in rgb)
    for at in range(
        0, len(table), _BLOCK
    ):  # in blocks, so that millions of points are not copied whole
        part = slice(at, at + _BLOCK)
        for k, name in enumerate("xyz"):
            points[part, k] = table[name][part]
        for channel, name in enumerate(rgb if colored else ()):
            colors[part, channel] = _bytes_of(table[name][part])
    return PointCloud(points=points, colors=colors)


def _bytes_of(values: np.ndarray) -> np.ndarray:
    """One channel [n] as 0 to 255: integers scaled from the range of their type, floats from 0 to
    1."""
    scale = 255.0 / np.iinfo(values.dtype).max if values.dtype.kind in "iu" else 255.0
    return np.clip(np.rint(np.nan_to_num(values.astype(np.float64) * scale)), 0, 255)
