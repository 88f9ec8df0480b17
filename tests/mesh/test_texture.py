"""Baked textures. Oracle: photos of a sphere whose colours are a function of the place."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("xatlas")

from gscore.commands.terminal.output import is_ours
from gscore.errors import ConfigError
from gscore.formats.gltf import Gltf
from gscore.io.images.png import png_bytes
from gscore.io.images.read_image import read_image
from gscore.mesh import MeshRequest, SurfaceMesh, make_mesh, write_surface
from gscore.mesh.surface_view import pixel_rays
from gscore.scene import Cameras
from tests.mesh.shapes import RADIUS, around, sphere

SIZE = 256


def _painted(cameras: Cameras, index: int) -> tuple[np.ndarray, None]:
    """The photo of a sphere of colours (place + 1) / 2; black beside it."""
    K, viewmat = cameras.Ks[index], cameras.viewmats[index]
    height, width = int(cameras.heights[index]), int(cameras.widths[index])
    rays = pixel_rays(K, height, width).astype(np.float64) @ viewmat[:3, :3]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    eye = cameras.centers[index]
    half = (rays @ eye) ** 2 - eye @ eye + RADIUS**2
    distance = -rays @ eye - np.sqrt(np.maximum(half, 0))
    places = eye + distance[..., None] * rays
    return np.where(half[..., None] > 0, (places + 1) / 2, 0).astype(np.float32), None


def _textured(cameras: Cameras, **request: object) -> SurfaceMesh:
    request = {"voxel": 0.06, "texture": SIZE, "triangles": 2000} | request
    photos = lambda index: _painted(cameras, index)  # noqa: E731
    return make_mesh(sphere(), cameras, MeshRequest(**request), photos=photos, threads=1)


def _at_vertices(mesh: SurfaceMesh) -> np.ndarray:
    """[V, 3], the texture at the vertices."""
    assert mesh.uvs is not None and mesh.texture is not None
    column, row = np.clip((mesh.uvs * SIZE).astype(int), 0, SIZE - 1).T
    return mesh.texture[row, column] / 255


@pytest.fixture(scope="module")
def ball() -> SurfaceMesh:
    """A textured sphere."""
    return _textured(around(24))


def test_the_texture_has_the_colours_of_the_photos(ball: SurfaceMesh) -> None:
    """Oracle: the function of the place; the splats have other colours."""
    assert ball.texture is not None and ball.texture.shape == (SIZE, SIZE, 3)
    error = np.abs(_at_vertices(ball) - (ball.vertices + 1) / 2).max(axis=1)
    assert np.median(error) < 0.02
    assert np.quantile(error, 0.95) < 0.06
    assert len(ball.triangles) <= 2000
    radii = np.linalg.norm(ball.vertices, axis=1)
    assert np.abs(radii - RADIUS).max() < 0.06


def test_what_no_photo_shows_keeps_the_colours_of_the_splats() -> None:
    """Oracle: masks that hide all photos; the splats are red and green."""
    cameras = around(24)
    hidden = np.zeros((120, 120), np.uint8)
    request = MeshRequest(voxel=0.06, texture=SIZE, triangles=2000)
    mesh = make_mesh(
        sphere(), cameras, request, photos=lambda i: (_painted(cameras, i)[0], hidden), threads=1
    )
    red = mesh.vertices[:, 0] > 0.2
    assert (_at_vertices(mesh)[red].argmax(axis=1) == 0).mean() > 0.97


def test_textures_in_files(ball: SurfaceMesh, tmp_path: Path) -> None:
    """Oracle: gscore's readers of glTF and PNG; the lines of OBJ and MTL; a PLY has none."""
    write_surface(tmp_path / "a.glb", ball)
    file = Gltf(tmp_path / "a.glb")
    primitive = file.content["meshes"][0]["primitives"][0]
    assert "COLOR_0" not in primitive["attributes"]
    uvs = file.numbers(primitive["attributes"]["TEXCOORD_0"], "VEC2")
    np.testing.assert_array_equal(uvs, ball.uvs)
    material = file.content["materials"][primitive["material"]]["pbrMetallicRoughness"]
    image = file.content["images"][file.content["textures"][0]["source"]]
    assert material["baseColorTexture"] == {"index": 0}
    assert bytes(file.view(image["bufferView"])) == png_bytes(ball.texture)
    write_surface(tmp_path / "a.obj", ball)
    lines = (tmp_path / "a.obj").read_text().splitlines()
    assert lines[1] == "mtllib a.mtl" and "usemtl Surface" in lines
    first = np.array(next(line for line in lines if line.startswith("vt ")).split()[1:], float)
    np.testing.assert_allclose(first, [ball.uvs[0, 0], 1 - ball.uvs[0, 1]], atol=1e-6)
    corner = ball.triangles[0] + 1
    faces = [line for line in lines if line.startswith("f ")]
    assert faces[0] == "f " + " ".join(f"{row}/{row}/{row}" for row in corner)
    assert len(faces) == len(ball.triangles)
    assert "map_Kd a.png" in (tmp_path / "a.mtl").read_text()
    np.testing.assert_array_equal(read_image(tmp_path / "a.png")[..., :3], ball.texture)
    assert all(is_ours(tmp_path / f"a.{ending}") for ending in ("glb", "obj", "mtl", "png"))
    with pytest.raises(ConfigError, match="a PLY has no texture"):
        write_surface(tmp_path / "a.ply", ball)


def test_bad_input_of_a_texture() -> None:
    """Oracle: one error each, which names what is wrong."""
    with pytest.raises(ConfigError, match="--texture"):
        MeshRequest(texture=4)
    with pytest.raises(ConfigError, match="needs the photos"):
        make_mesh(sphere(), around(4), MeshRequest(texture=SIZE))
    assert MeshRequest(texture=SIZE).most and MeshRequest().most is None
    assert replace(MeshRequest(texture=SIZE), triangles=7).most == 7
