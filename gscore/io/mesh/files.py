"""Mesh files: reader of either format."""

from pathlib import Path

from ...errors import DatasetError, FormatError
from ...quoting import brief
from ..files import open_regular, reason
from .obj import read_mesh_obj
from .ply import read_mesh_ply
from .triangles import TriangleMesh


def read_mesh(path: str | Path) -> TriangleMesh:
    """Read a mesh, PLY by its content, OBJ by its name.

    Polygons of more than three corners become fans about their first corners, which is right where
    they are convex.

    Raises:
        DatasetError: the file is missing or cannot be opened.
        FormatError: it is of another format, damaged, or holds no mesh.
    """
    path = Path(path)
    if _begins_with_ply(path):
        return read_mesh_ply(path)
    if path.suffix.lower() == ".obj":
        return read_mesh_obj(path)
    raise FormatError(
        f"{path} is neither a PLY nor an OBJ file. Export the mesh as one of these, in the world "
        "of the capture."
    )


def _begins_with_ply(path: Path) -> bool:
    try:
        with open_regular(path) as file:
            return file.read(3) == b"ply"
    except (OSError, ValueError) as error:
        raise DatasetError(f"Cannot read {brief(path)}: {reason(error)}") from error
