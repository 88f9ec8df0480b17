"""PLY meshes: reader and writer."""

from pathlib import Path
from typing import BinaryIO

import numpy as np

from ...errors import FormatError
from ..files import atomic_write
from ..ply.elements import read_elements
from .triangles import TriangleMesh, check_count, checked_mesh, fans

_FACES = ("vertex_indices", "vertex_index")
"""Names of the list of a face's corners; programs use either."""
_ROWS = 1 << 18
"""Faces written at a time."""


def read_mesh_ply(path: Path) -> TriangleMesh:
    """Read the faces of a PLY file as triangles.

    Raises:
        DatasetError: the file is missing or cannot be opened.
        FormatError: it is damaged, or contains no mesh.
    """
    elements = read_elements(path)
    table = elements.get("vertex", np.zeros(0, [("none", "f4")]))
    names = table.dtype.names or ()
    if any(axis not in names or table.dtype[axis].kind == "O" for axis in "xyz"):
        raise FormatError(f"{path} has no vertices with x, y, z. Export the mesh again.")
    if "face" not in elements and {"f_dc_0", "opacity"} & set(names):
        raise FormatError(f"{path} contains Gaussian splats and no faces. Give a mesh.")
    faces = elements.get("face", np.zeros(0, [("none", "f4")]))
    lists = [name for name in _FACES if name in (faces.dtype.names or ())]
    if len(faces) and not (lists and faces.dtype[lists[0]].kind == "O"):
        raise FormatError(
            f"{path}: its faces have no list {' or '.join(_FACES)}. Export the mesh again."
        )
    check_count(path, len(faces))
    vertices = np.stack([np.asarray(table[axis], np.float64) for axis in "xyz"], axis=1)
    corners = list(faces[lists[0]]) if len(faces) else []
    if corners and corners[0].dtype.kind not in "iu":
        raise FormatError(f"{path}: corners of faces are not whole numbers. Export the mesh again.")
    return checked_mesh(path, vertices, fans(corners))


def write_mesh(path: str | Path, vertices: np.ndarray, triangles: np.ndarray) -> None:
    """Write triangles as a binary PLY, completely or not at all.

    Args:
        path: The file.
        vertices: [V, 3] float; stored in double precision.
        triangles: [T, 3] int, rows of `vertices`.

    Raises:
        GsError: the file cannot be written.
    """
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment made by gscore\n"
        f"element vertex {len(vertices)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )

    def write(file: BinaryIO) -> None:
        file.write(header.encode("ascii"))
        file.write(np.ascontiguousarray(vertices, "<f8").tobytes())
        for at in range(0, len(triangles), _ROWS):
            part = triangles[at : at + _ROWS]
            rows = np.empty(len(part), [("count", "u1"), ("corners", "<i4", 3)])
            rows["count"], rows["corners"] = 3, part
            file.write(rows.tobytes())

    atomic_write(path, write)
