"""Plain point clouds from PLY files."""

from pathlib import Path

import numpy as np

from ..errors import FormatError
from ..scene import PointCloud
from .ply_elements import read_elements


def read_point_cloud(path: str | Path) -> PointCloud:
    """Positions and colours of the vertices of any PLY file; black where it has no colours.

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
    points = np.stack([table[name].astype(np.float64) for name in "xyz"], axis=1)
    colors = np.zeros((len(points), 3), np.uint8)
    rgb = ("red", "green", "blue")
    if all(name in names and table.dtype[name].kind in "iuf" for name in rgb):
        for channel, name in enumerate(rgb):
            values = table[name]
            scale = 255.0 / np.iinfo(values.dtype).max if values.dtype.kind in "iu" else 255.0
            scaled = np.nan_to_num(values.astype(np.float64) * scale)
            colors[:, channel] = np.clip(np.rint(scaled), 0, 255)
    return PointCloud(points=points, colors=colors)
