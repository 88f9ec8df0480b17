"""Mesh files. Oracles: other readers (plyfile, gscore's of OBJ and glTF), the formats."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import plyfile
import pytest
from scipy.spatial.transform import Rotation

from gscore.commands.terminal.output import is_ours
from gscore.errors import ConfigError, FormatError
from gscore.formats.gltf import Gltf
from gscore.io.mesh.files import read_mesh, write_mesh
from gscore.mesh import SurfaceMesh, read_surface, write_surface
from gscore.mesh.surface_mesh import ENDINGS

ORIGIN = np.array([600000.251, -5000000.513, 100.0])
MESH = SurfaceMesh(
    vertices=np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]]),
    triangles=np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]),
    colors=np.array([[0, 0.5, 1], [1, 0, 0], [0.02, 0.2, 0.8], [1, 1, 1]], np.float32),
    origin=ORIGIN,
)


@pytest.mark.parametrize("ending", [".ply", ".obj"])
def test_places_and_triangles_are_read_back(tmp_path: Path, ending: str) -> None:
    """Oracle: gscore's reader; georeferenced coordinates keep a millimetre, files have the mark."""
    path = tmp_path / f"a{ending}"
    write_surface(path, MESH)
    found = read_mesh(path)
    np.testing.assert_allclose(found.vertices, MESH.vertices + ORIGIN, rtol=0, atol=1e-4)
    np.testing.assert_array_equal(found.triangles, MESH.triangles)
    assert is_ours(path)


def test_a_ply_has_normals_and_colours(tmp_path: Path) -> None:
    """Oracle: plyfile; the corner's normal by symmetry."""
    path = tmp_path / "a.ply"
    write_surface(path, MESH)
    vertex = plyfile.PlyData.read(str(path))["vertex"]
    rgb = np.stack([vertex[name] for name in ("red", "green", "blue")], axis=1)
    np.testing.assert_array_equal(rgb, np.rint(MESH.colors * 255))
    normals = np.stack([vertex[name] for name in ("nx", "ny", "nz")], axis=1)
    np.testing.assert_allclose(normals[0], -np.ones(3) / 3**0.5, atol=1e-6)
    assert (vertex["x"] == MESH.in_capture[:, 0]).all()


def test_a_written_ply_is_read_back_whole(tmp_path: Path) -> None:
    """Oracle: the mesh; files of other programs and damaged ones are refused."""
    path = tmp_path / "a.ply"
    write_surface(path, MESH)
    found = read_surface(path)
    np.testing.assert_array_equal(found.vertices, MESH.in_capture)
    np.testing.assert_array_equal(found.triangles, MESH.triangles)
    np.testing.assert_allclose(found.colors, MESH.colors, atol=0.5 / 255 + 1e-6)
    whole = path.read_bytes()
    damaged = bytearray(whole)
    damaged[-1] = 0x7F  # a corner beyond the vertices
    for content in (whole[:-1], bytes(damaged), whole.replace(b"gscore", b"others"), b"ply\n", b""):
        path.write_bytes(content)
        with pytest.raises(FormatError, match="Make it again"):
            read_surface(path)
    write_mesh(path, MESH.vertices, MESH.triangles)
    with pytest.raises(FormatError, match="no colours"):
        read_surface(path)


def test_an_obj_has_normals_and_colours(tmp_path: Path) -> None:
    """Oracle: the lines of the format; colours after places as fractions."""
    path = tmp_path / "a.obj"
    write_surface(path, MESH)
    lines = path.read_text().splitlines()
    kinds = [line.split()[0] for line in lines]
    assert kinds == ["#", *["v"] * 4, *["vn"] * 4, *["f"] * 4]
    assert lines[1].split()[4:] == ["0.0000", "0.5020", "1.0000"]
    assert lines[9] == "f 1//1 3//3 2//2"


def test_a_glb_has_the_axes_and_colours_of_gltf(tmp_path: Path) -> None:
    """Oracle: the accessors, read by gscore's reader; IEC 61966-2-1; y up, from y down or z up."""
    path = tmp_path / "a.glb"
    write_surface(path, MESH)
    file = Gltf(path)
    primitive = file.content["meshes"][0]["primitives"][0]
    places = file.numbers(primitive["attributes"]["POSITION"], "VEC3")
    np.testing.assert_array_equal(places, MESH.vertices * [-1, -1, 1])
    colors = file.numbers(primitive["attributes"]["COLOR_0"], "VEC3")
    np.testing.assert_allclose(colors[0], [0, 0.21404, 1], atol=1e-4)
    np.testing.assert_allclose(colors[2], [0.02 / 12.92, 0.03310, 0.60383], atol=1e-4)
    accessor = file.entry("accessors", primitive["indices"])
    assert (accessor["componentType"], accessor["count"]) == (5125, 12)
    indices = np.frombuffer(file.view(accessor["bufferView"]), np.uint32)
    np.testing.assert_array_equal(indices.reshape(-1, 3), MESH.triangles)
    node = file.content["nodes"][0]
    assert "rotation" not in node
    np.testing.assert_allclose(node["translation"], ORIGIN * [-1, -1, 1])
    write_surface(path, replace(MESH, up="Z"))
    node = Gltf(path).content["nodes"][0]
    turn = Rotation.from_quat(node["rotation"])
    np.testing.assert_allclose(turn.apply(places[3]), [0, 1, 0], atol=1e-12)  # z
    np.testing.assert_allclose(node["translation"], ORIGIN[[0, 2, 1]] * [1, 1, -1], atol=1e-6)
    assert is_ours(path)
    json.dumps(file.content, allow_nan=False)


def test_other_endings_are_refused(tmp_path: Path) -> None:
    """Oracle: a sentence with the endings that are written, and no file."""
    for name in ("a.stl", "a", "a.gltf"):
        with pytest.raises(ConfigError, match=", ".join(ENDINGS).replace(".", r"\.")):
            write_surface(tmp_path / name, MESH)
    assert not list(tmp_path.iterdir())
