"""OBJ meshes (Wavefront, appendix B1): vertices and faces; appearance is ignored."""

from pathlib import Path

import numpy as np

from ...errors import FormatError
from ...quoting import quoted
from ..files import read_bytes
from .triangles import TriangleMesh, check_count, checked_mesh, fans

_LAST = 2**31 - 1
"""Largest row number, of int32."""


def read_mesh_obj(path: Path) -> TriangleMesh:
    """Read the faces of all objects in an OBJ file as triangles.

    Raises:
        DatasetError: the file is missing or cannot be opened.
        FormatError: a line is invalid, or the file contains no mesh.
    """
    vertices: list[tuple[float, ...]] = []
    polygons: list[list[int]] = []
    for at, line in enumerate(read_bytes(path).splitlines(), start=1):
        words = line.split()
        kind = words[0] if words else b""
        if kind not in (b"v", b"f"):
            continue
        try:
            if kind == b"v":
                vertices.append((float(words[1]), float(words[2]), float(words[3])))
            else:
                polygons.append([_row(word, len(vertices)) for word in words[1:]])
        except (ValueError, IndexError) as error:
            what = "vertex" if kind == b"v" else "face"
            raise FormatError(
                f"{path}: line {at} is not a {what}: {quoted(line.decode('utf-8', 'replace'))}. "
                "Export the mesh again."
            ) from error
    check_count(path, len(polygons))
    points = np.array(vertices, np.float64).reshape(-1, 3)
    return checked_mesh(path, points, fans([np.array(polygon, np.int64) for polygon in polygons]))


def _row(word: bytes, known: int) -> int:
    """Row, from 0, of a corner like 7, 7/1, 7/1/3 or 7//3; negative ones count from the end."""
    stated = int(word.split(b"/", 1)[0])
    if stated == 0 or abs(stated) > _LAST:
        raise ValueError("no row of a file")
    return stated - 1 if stated > 0 else known + stated
