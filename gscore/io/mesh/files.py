"""Triangle meshes, and their reader from PLY and OBJ."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ...errors import DatasetError, FormatError
from ...quoting import brief, quoted
from ...text_format import count_text, number
from ..files import atomic_write, open_regular, read_bytes, reason
from ..ply.elements import read_elements

MOST_TRIANGLES = 20_000_000
"""Most triangles of a mesh: more take gigabytes without locating the surface better."""
_LARGEST = 1e9
"""Largest coordinate; scenes in any unit are smaller, and its products with K stay exact."""


@dataclass(frozen=True, kw_only=True)
class TriangleMesh:
    """Triangles with shared vertices."""

    vertices: np.ndarray
    """[V, 3] float64, world of the capture."""
    triangles: np.ndarray
    """[T, 3] int32, rows of `vertices`."""

    def __len__(self) -> int:
        return len(self.triangles)


def checked_mesh(path: Path, vertices: np.ndarray, triangles: np.ndarray) -> TriangleMesh:
    """Mesh of a file, after checks.

    Args:
        path: The file, for messages.
        vertices: [V, 3] float64.
        triangles: [T, 3] int64.

    Raises:
        FormatError: there are no triangles or too many, or one uses a vertex that does not exist or
            has coordinates that are not finite or too large.
    """
    if len(triangles) == 0:
        raise FormatError(
            f"{path} has no faces ({count_text(len(vertices), 'vertex', 'vertices')}). Export a "
            "mesh with faces; a point cloud has none."
        )
    check_count(path, len(triangles))
    outside = (triangles < 0) | (triangles >= len(vertices))
    if outside.any():
        row, corner = (int(at) for at in np.argwhere(outside)[0])
        raise FormatError(
            f"{path} is damaged: a face uses vertex {int(triangles[row, corner])} of "
            f"{number(len(vertices))}. Export it again."
        )
    with np.errstate(invalid="ignore"):
        good = (np.abs(vertices) <= _LARGEST).all(axis=1)
    used = np.zeros(len(vertices), bool)
    used[triangles.ravel()] = True
    wrong = np.flatnonzero(used & ~good)
    if len(wrong):
        raise FormatError(
            f"{path}: {count_text(len(wrong), 'vertex is', 'vertices are')} not finite or larger "
            f"than {_LARGEST:g}, the first one number {wrong[0]} (counted from 0): "
            f"{vertices[wrong[0]].tolist()}. "
            "Clean the mesh up and export it again."
        )
    points = vertices.copy()
    points[~good] = 0  # no face uses them
    return TriangleMesh(vertices=points, triangles=np.ascontiguousarray(triangles, np.int32))


def check_count(path: Path, triangles: int) -> None:
    """Raise FormatError for more than `MOST_TRIANGLES`."""
    if triangles > MOST_TRIANGLES:
        raise FormatError(
            f"{path} has {number(triangles)} triangles, at most {number(MOST_TRIANGLES)} are "
            "supported. Simplify the mesh; a hundred thousand are enough for a room."
        )


def fans(polygons: Sequence[np.ndarray]) -> np.ndarray:
    """[T, 3] int64 triangle fans around the first corners of polygons [n] int each; polygons with
    less than 3 corners give none."""
    sizes = np.fromiter((len(polygon) for polygon in polygons), np.int64, len(polygons))
    if not (sizes >= 3).any():
        return np.zeros((0, 3), np.int64)
    flat = np.concatenate(list(polygons)).astype(np.int64)
    starts = np.cumsum(sizes) - sizes
    counts = np.maximum(sizes - 2, 0)
    first = np.repeat(starts, counts)
    step = np.arange(len(first)) - np.repeat(np.cumsum(counts) - counts, counts)
    return np.stack([flat[first], flat[first + step + 1], flat[first + step + 2]], axis=1)


def read_mesh(path: str | Path) -> TriangleMesh:
    """Read a mesh; PLY is recognised by content, OBJ by name.

    Polygons of more than three corners become fans around their first corner, which is right for
    convex ones.

    Raises:
        DatasetError: the file is missing or cannot be opened.
        FormatError: it has another format, is damaged, or contains no mesh.
    """
    path = Path(path)
    if _begins_with_ply(path):
        return read_mesh_ply(path)
    if path.suffix.lower() == ".obj":
        return read_mesh_obj(path)
    raise FormatError(
        f"{path} is neither a PLY nor an OBJ file. Write the mesh as one of these "
        "(`gscore mesh RUN -o mesh.ply` does), in the world of the capture."
    )


def _begins_with_ply(path: Path) -> bool:
    try:
        with open_regular(path) as file:
            return file.read(3) == b"ply"
    except (OSError, ValueError) as error:
        raise DatasetError(f"Cannot read {brief(path)}: {reason(error)}") from error


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


def write_mesh(
    path: str | Path,
    vertices: np.ndarray,
    triangles: np.ndarray,
    *,
    normals: np.ndarray | None = None,
    colors: np.ndarray | None = None,
) -> None:
    """Write triangles as a binary PLY, completely or not at all.

    Args:
        path: The file.
        vertices: [V, 3] float; stored in double precision.
        triangles: [T, 3] int, rows of `vertices`.
        normals: [V, 3] float; None: none are stored.
        colors: [V, 3] uint8 RGB; None: none are stored.

    Raises:
        GsError: the file cannot be written.
    """
    table = np.empty(len(vertices), _table_type(normals is not None, colors is not None))
    for names, columns in (("xyz", vertices), (_NORMAL, normals), (_COLOR, colors)):
        if columns is not None:
            for axis, name in enumerate(names):
                table[name] = columns[:, axis]
    header = _header(len(vertices), len(triangles), table.dtype)

    def write(file: BinaryIO) -> None:
        file.write(header)
        file.write(table.tobytes())
        for at in range(0, len(triangles), _ROWS):
            part = triangles[at : at + _ROWS]
            rows = np.empty(len(part), _TRIANGLE)
            rows["count"], rows["corners"] = 3, part
            file.write(rows.tobytes())

    atomic_write(path, write)


_NORMAL, _COLOR = ("nx", "ny", "nz"), ("red", "green", "blue")
_PLY_TYPES = {"f8": "double", "f4": "float", "u1": "uchar"}
"""Names of types in a PLY header, by dtype."""


_TRIANGLE = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
"""A face of a written PLY."""
_COUNTS = re.compile(rb"element vertex (\d{1,9})\n.*element face (\d{1,9})\n", re.DOTALL)
_LONGEST_HEADER = 1000


def read_written_mesh(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Read a PLY of `write_mesh`, in a fraction of the time of `read_mesh`.

    Returns:
        Vertices [V] with the fields x, y, z, and nx, ny, nz and red, green, blue if it has them;
        triangles [T, 3] int32.

    Raises:
        DatasetError: the file is missing or cannot be opened.
        FormatError: another program wrote it, or it is damaged.
    """
    raw = memoryview(read_bytes(path))
    counts = _COUNTS.search(bytes(raw[:_LONGEST_HEADER]))
    vertices, faces = (int(counts[1]), int(counts[2])) if counts else (0, 0)
    for normals, colors in ((False, False), (True, True), (True, False), (False, True)):
        kind = _table_type(normals, colors)
        header = _header(vertices, faces, kind)
        if raw[: len(header)] != header:
            continue
        end = len(header) + vertices * kind.itemsize
        if len(raw) != end + faces * _TRIANGLE.itemsize:
            break
        triangles = np.frombuffer(raw, _TRIANGLE, faces, end)["corners"]
        if faces and (triangles.min() < 0 or triangles.max() >= vertices):
            break
        return np.frombuffer(raw, kind, vertices, len(header)), np.ascontiguousarray(triangles)
    raise FormatError(f"{path} is no mesh that gscore wrote, or it is damaged. Make it again.")


def _header(vertices: int, faces: int, kind: np.dtype) -> bytes:
    """Header of a written PLY with vertices of a dtype."""
    properties = "".join(
        f"property {_PLY_TYPES[kind[name].kind + str(kind[name].itemsize)]} {name}\n"
        for name in kind.names or ()
    )
    return (
        "ply\nformat binary_little_endian 1.0\ncomment made by gscore\n"
        f"element vertex {vertices}\n{properties}"
        f"element face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode("ascii")


def _table_type(normals: bool, colors: bool) -> np.dtype:
    columns = [(name, "<f8") for name in "xyz"]
    columns += [(name, "<f4") for name in _NORMAL if normals]
    return np.dtype(columns + [(name, "u1") for name in _COLOR if colors])
