"""Mesh of a surface with colours, and its files: PLY, OBJ and GLB."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from .._version import __version__
from ..errors import ConfigError, FormatError
from ..formats.gltf import TO_GLTF, GltfBuffer, upright_node, write_glb
from ..io.files import atomic_write
from ..io.images.pixels import srgb_to_linear
from ..io.images.png import SIGNED, png_bytes, write_png
from ..io.mesh.files import read_written_mesh, write_mesh
from ..quoting import brief
from .clean import vertex_normals

ENDINGS = (".ply", ".obj", ".glb")
"""Endings of mesh files that are written."""
_LINEAR, _MIPMAPS = 9729, 9987
"""Filters of textures."""
_LINES = 1 << 16
"""Lines of an OBJ written at a time."""


@dataclass(frozen=True, kw_only=True)
class SurfaceMesh:
    """Triangles with colours."""

    vertices: np.ndarray
    """[V, 3] float64, world of the splats, from `origin`."""
    triangles: np.ndarray
    """[T, 3] int64, rows of `vertices`, counter-clockwise from outside."""
    colors: np.ndarray
    """[V, 3] float32 in [0, 1], in the encoding of the photos (sRGB)."""
    uvs: np.ndarray | None = None
    """[V, 2] float32 in [0, 1], places in `texture` from its top left corner."""
    texture: np.ndarray | None = None
    """[S, S, 3] uint8, sRGB; None: the colours are those of the vertices."""
    origin: np.ndarray | None = None
    """[3] float64, local origin in the coordinates of the capture; None: zero."""
    up: str = ""
    """Up axis of the world, X to -Z; empty: unknown, taken as -Y by a .glb."""
    facts: dict[str, Any] = field(default_factory=dict)
    """Figures of its making, as JSON values."""

    @property
    def in_capture(self) -> np.ndarray:
        """[V, 3] float64, vertices in the coordinates of the capture."""
        return self.vertices if self.origin is None else self.vertices + self.origin


def files_written(path: Path, *, texture: bool) -> list[Path]:
    """The files of a mesh: `path`, and those beside it of a textured .obj."""
    beside = texture and path.suffix.lower() == ".obj"
    return [path, *((path.with_suffix(".mtl"), path.with_suffix(".png")) if beside else ())]


def check_ending(path: Path, *, texture: bool = False) -> None:
    """Raise ConfigError unless a mesh can be written with the ending of `path`."""
    if texture and path.suffix.lower() == ".ply":
        raise ConfigError(f"{brief(path)}: a PLY has no texture; give a .glb or an .obj.")
    if path.suffix.lower() not in _WRITERS:
        raise ConfigError(
            f"{brief(path)}: a mesh is written as {', '.join(ENDINGS)}; give one of these endings."
        )


def write_surface(path: str | Path, mesh: SurfaceMesh) -> None:
    """Write a mesh by the ending of its name, completely or not at all.

    PLY and OBJ have the coordinates of the capture and colours of 8 bits or as fractions. GLB has
    y up, as the splats' GLB, linear colours and the local origin as the place of its node. A
    texture is a part of the GLB; an OBJ has it in a .png with a .mtl beside it.

    Args:
        path: A .ply, .obj or .glb file.
        mesh: The mesh.

    Raises:
        ConfigError: the name has another ending, or the mesh is too large for a .glb.
        GsError: the file cannot be written.
    """
    path = Path(path)
    check_ending(path, texture=mesh.texture is not None)
    _WRITERS[path.suffix.lower()](path, mesh)


def read_surface(path: str | Path) -> SurfaceMesh:
    """Read a PLY that `write_surface` wrote; the mesh has the coordinates of the capture.

    Raises:
        DatasetError: the file is missing or cannot be opened.
        FormatError: another program wrote it, or it is damaged.
    """
    vertex, triangles = read_written_mesh(Path(path))
    names = vertex.dtype.names or ()
    if "red" not in names:
        raise FormatError(f"{brief(path)} has no colours. Make it again with gscore mesh.")
    colors = np.stack([vertex[name] for name in ("red", "green", "blue")], axis=1)
    return SurfaceMesh(
        vertices=np.stack([vertex[axis] for axis in "xyz"], axis=1),
        triangles=triangles.astype(np.int64),
        colors=colors.astype(np.float32) / 255,
    )


def _write_ply(path: Path, mesh: SurfaceMesh) -> None:
    normals = vertex_normals(mesh.vertices, mesh.triangles)
    write_mesh(path, mesh.in_capture, mesh.triangles, normals=normals, colors=_bytes(mesh))


def _write_obj(path: Path, mesh: SurfaceMesh) -> None:
    normals = vertex_normals(mesh.vertices, mesh.triangles)
    head, parts = "# made by gscore\n", []
    # Digits of doubles where coordinates are large; 9 resolve a local world finer than its voxels.
    place = "%.9g %.9g %.9g" if mesh.origin is None else "%.15g %.15g %.15g"
    if mesh.texture is None or mesh.uvs is None:
        vertices = np.concatenate([mesh.in_capture, _bytes(mesh) / 255], axis=1)
        parts.append((f"v {place} %.4f %.4f %.4f\n", vertices))
        corner = "%d//%d"
    else:
        _, material, picture = files_written(path, texture=True)
        write_png(picture, mesh.texture, SIGNED)
        atomic_write(material, f"{head}newmtl Surface\nKd 1 1 1\nmap_Kd {picture.name}\n".encode())
        head += f"mtllib {material.name}\n"
        up = mesh.uvs * [1, -1] + [0, 1]  # from the bottom left corner
        parts += [(f"v {place}\n", mesh.in_capture), ("vt %.6f %.6f\n", up)]
        corner = "%d/%d/%d"
    corners = np.repeat(mesh.triangles + 1, corner.count("%"), axis=1)
    parts += [("vn %.4f %.4f %.4f\n", normals), (f"f {corner} {corner} {corner}\n", corners)]

    def write(file: BinaryIO) -> None:
        file.write(head.encode())
        for pattern, rows in parts:
            if pattern.startswith("f") and mesh.texture is not None:
                file.write(b"usemtl Surface\n")
            for at in range(0, len(rows), _LINES):
                part = rows[at : at + _LINES]
                file.write((pattern * len(part) % tuple(part.ravel().tolist())).encode("ascii"))

    atomic_write(path, write)


def _write_glb(path: Path, mesh: SurfaceMesh) -> None:
    buffer = GltfBuffer()
    places = (mesh.vertices * TO_GLTF).astype(np.float32)
    bounds = {}
    if len(places):
        bounds = {"min": places.min(axis=0).tolist(), "max": places.max(axis=0).tolist()}
    attributes = {
        "POSITION": buffer.add(places, "VEC3", **bounds),
        "NORMAL": buffer.add(vertex_normals(places, mesh.triangles), "VEC3"),
    }
    surface: dict[str, Any] = {"metallicFactor": 0, "roughnessFactor": 1}
    pictures: dict[str, Any] = {}
    if mesh.texture is None or mesh.uvs is None:
        colors = srgb_to_linear(np.clip(mesh.colors, 0, 1))
        attributes["COLOR_0"] = buffer.add(colors.astype(np.float32), "VEC3")
    else:
        attributes["TEXCOORD_0"] = buffer.add(mesh.uvs.astype(np.float32), "VEC2")
        surface["baseColorTexture"] = {"index": 0}
        view = buffer.add_bytes(png_bytes(mesh.texture))
        pictures = {
            "textures": [{"source": 0, "sampler": 0}],
            "samplers": [{"magFilter": _LINEAR, "minFilter": _MIPMAPS}],
            "images": [{"bufferView": view, "mimeType": "image/png"}],
        }
    faces = np.ascontiguousarray(mesh.triangles, np.uint32).reshape(-1)
    indices = buffer.add(faces, "SCALAR")
    node = {"mesh": 0, "name": path.stem, **upright_node(mesh.up, mesh.origin)}
    content = {
        "asset": {"version": "2.0", "generator": f"gscore {__version__}"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [node],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}],
        "materials": [{"name": "Surface", "pbrMetallicRoughness": surface}],
        **pictures,
        "accessors": buffer.accessors,
        "bufferViews": buffer.views,
        "buffers": [{"byteLength": buffer.size}],
    }
    atomic_write(path, lambda file: write_glb(file, content, buffer))


def _bytes(mesh: SurfaceMesh) -> np.ndarray:
    return np.rint(np.clip(mesh.colors, 0, 1) * 255).astype(np.uint8)


_WRITERS: dict[str, Callable[[Path, SurfaceMesh], None]] = {
    ".ply": _write_ply,
    ".obj": _write_obj,
    ".glb": _write_glb,
}
