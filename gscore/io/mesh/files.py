"""Mesh files: reader of PLY and OBJ."""

from pathlib import Path

from ...errors import DatasetError, FormatError
from ...quoting import brief
from ..files import open_regular, reason
from .obj import read_mesh_obj
from .ply import read_mesh_ply
from .triangles import TriangleMesh


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
        f"{path} is neither a PLY nor an OBJ file. Export the mesh as one of these, in the world "
        "of the capture."
    )


def _begins_with_ply(path: Path) -> bool:
    try:
        with open_regular(path) as file:
            return file.read(3) == b"ply"
    except (OSError, ValueError) as error:
        raise DatasetError(f"Cannot read {brief(path)}: {reason(error)}") from error
