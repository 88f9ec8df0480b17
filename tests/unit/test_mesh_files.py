"""Meshes from files; oracles: triangles counted by hand, plyfile's own writer, the docstrings."""

from pathlib import Path

import numpy as np
import plyfile
import pytest

from gscore.errors import DatasetError, FormatError
from gscore.io.mesh.files import MOST_TRIANGLES, check_count, read_mesh, write_mesh

SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float64)
FAN = [[0, 1, 2], [0, 2, 3]]


def ply_of(path: Path, faces: list[list[int]], *, text: bool, name: str = "vertex_indices") -> Path:
    """A file as written by another program."""
    vertex = np.array([tuple(row) for row in SQUARE], [(axis, "f4") for axis in "xyz"])
    face = np.empty(len(faces), [(name, "O"), ("flags", "u1")])
    for at, corners in enumerate(faces):
        face[at] = np.array(corners, np.int32), 0
    elements = [
        plyfile.PlyElement.describe(vertex, "vertex"),
        plyfile.PlyElement.describe(face, "face", len_types={name: "u1"}, val_types={name: "u4"}),
    ]
    plyfile.PlyData(elements, text=text).write(str(path))
    return path


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("name", ["vertex_indices", "vertex_index"])
def test_faces_of_a_ply_become_triangles(tmp_path: Path, text: bool, name: str) -> None:
    """Oracle: a square and a triangle, by hand, written by plyfile."""
    path = ply_of(tmp_path / "a.ply", [[0, 1, 2, 3], [3, 1, 0]], text=text, name=name)
    found = read_mesh(path)
    assert found.triangles.tolist() == [*FAN, [3, 1, 0]]
    np.testing.assert_array_equal(found.vertices, SQUARE)


def test_faces_of_an_obj_become_triangles(tmp_path: Path) -> None:
    """Oracle: by hand; all ways in which the format refers to corners."""
    path = tmp_path / "a.OBJ"
    path.write_text(
        "# a comment\nmtllib x.mtl\no one\nv 0 0 0\nv 1 0 0 1.0\nv 1 1 0\nv 0 1 0\nvt 0 0\n"
        "vn 0 0 1\nusemtl m\ns off\nf 1/1/1 2//1 3/1 4\nf -1 -3 -4\nl 1 2\n"
    )
    found = read_mesh(path)
    assert found.triangles.tolist() == [*FAN, [3, 1, 0]]
    np.testing.assert_array_equal(found.vertices, SQUARE)


def test_meshes_round_trip(tmp_path: Path) -> None:
    """Oracle: the arrays, to the bit; the same from plyfile."""
    rng = np.random.default_rng(0)
    vertices, triangles = rng.normal(size=(50, 3)), rng.integers(0, 50, (300_000, 3))
    write_mesh(tmp_path / "a.ply", vertices, triangles)
    found = read_mesh(tmp_path / "a.ply")
    np.testing.assert_array_equal(found.vertices, vertices)
    np.testing.assert_array_equal(found.triangles, triangles)
    first = plyfile.PlyData.read(str(tmp_path / "a.ply"))["face"].data["vertex_indices"][0]
    assert first.tolist() == triangles[0].tolist()


OBJS = {
    "no faces": ("v 0 0 0\nv 1 0 0\n", r"no faces \(2 vertices\)"),
    "nothing": ("", "no faces"),
    "only edges": ("v 0 0 0\nv 1 0 0\nf 1 2\n", "no faces"),
    "a corner that is not there": ("v 0 0 0\nf 1 1 7\n", "uses vertex 6 of 1"),
    "one before the first": ("v 0 0 0\nf 1 1 -3\n", "uses vertex -2"),
    "a corner that is no number": ("v 0 0 0\nf 1 x 1\n", "line 2 is not a face: 'f 1 x 1'"),
    "a corner beyond all counting": (f"v 0 0 0\nf 1 1 {10**20}\n", "line 2 is not a face"),
    "corner 0": ("v 0 0 0\nf 0 1 1\n", "line 2 is not a face"),
    "a vertex of two numbers": ("v 0 0\n", "line 1 is not a vertex"),
    "NaN": ("v 0 0 0\nv nan 0 0\nv 1 0 0\nf 1 2 3\n", "1 vertex is not finite or .*number 1"),
    "infinity": ("v 0 0 0\nv inf 0 0\nv 1 1e30 0\nf 1 2 3\n", "2 vertices are not finite"),
}


@pytest.mark.parametrize("name", OBJS)
def test_invalid_meshes_are_refused(tmp_path: Path, name: str) -> None:
    """Oracle: the entry named in the sentence."""
    content, words = OBJS[name]
    path = tmp_path / "a.obj"
    path.write_text(content)
    with pytest.raises(FormatError, match=words) as found:
        read_mesh(path)
    assert str(path) in str(found.value)


def test_vertices_that_no_face_uses_may_be_anything(tmp_path: Path) -> None:
    """Oracle: the valid triangle."""
    path = tmp_path / "a.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv nan 0 0\nf 1 2 3\n")
    assert read_mesh(path).triangles.tolist() == [[0, 1, 2]]
    assert np.isfinite(read_mesh(path).vertices).all()


def test_other_files_are_refused(tmp_path: Path) -> None:
    """Oracle: the kind named in the sentence: a format, splats, a folder, a missing file."""
    (tmp_path / "a.glb").write_bytes(b"glTF\2\0\0\0")
    with pytest.raises(FormatError, match="neither a PLY nor an OBJ"):
        read_mesh(tmp_path / "a.glb")
    with pytest.raises(DatasetError, match="no such file"):
        read_mesh(tmp_path / "none.ply")
    with pytest.raises(DatasetError, match="folder"):
        read_mesh(tmp_path)
    (tmp_path / "b.ply").write_bytes(b"plybroken")
    with pytest.raises(FormatError, match="not a PLY"):
        read_mesh(tmp_path / "b.ply")
    names = ["x", "y", "z", "f_dc_0", "opacity"]
    splats = plyfile.PlyElement.describe(np.zeros(3, [(n, "f4") for n in names]), "vertex")
    plyfile.PlyData([splats]).write(str(tmp_path / "c.ply"))
    with pytest.raises(FormatError, match="Gaussian splats and no faces"):
        read_mesh(tmp_path / "c.ply")


def test_too_many_triangles_are_refused() -> None:
    """Oracle: the limit."""
    check_count(Path("a"), MOST_TRIANGLES)
    with pytest.raises(FormatError, match=r"20,000,001 triangles.*Simplify"):
        check_count(Path("a"), MOST_TRIANGLES + 1)
