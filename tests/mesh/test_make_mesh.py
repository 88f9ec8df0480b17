"""Oracles: shapes whose surfaces are known, and Euler's formula."""

import sys
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree

from gscore.errors import Cancelled, ConfigError, DatasetError
from gscore.formats.joined import joined
from gscore.mesh import MeshRequest, SurfaceMesh, make_mesh
from gscore.mesh.clean import boundary_loops, vertex_normals
from gscore.mesh.volume import BLOCK_BYTES
from gscore.raster.api import render_camera
from tests.mesh.shapes import RADIUS, around, box, flat_splats, from_box, sphere

VOXEL = 0.05


def _mesh(**request: object) -> SurfaceMesh:
    return make_mesh(sphere(), around(), MeshRequest(voxel=VOXEL, **request), threads=1)


@pytest.fixture(scope="module")
def ball() -> SurfaceMesh:
    """The mesh of a sphere seen from all sides."""
    return _mesh()


def _euler(mesh: SurfaceMesh) -> int:
    edges = np.sort(mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return len(mesh.vertices) - len(np.unique(edges, axis=0)) + len(mesh.triangles)


def test_a_sphere_is_closed_and_in_its_place(ball: SurfaceMesh) -> None:
    """Oracle: radius and normals of the sphere; V - E + F = 2 of a closed surface; each directed
    edge occurs once, with its opposite."""
    radii = np.linalg.norm(ball.vertices, axis=1)
    error = np.abs(radii - RADIUS) / VOXEL
    assert np.median(error) < 0.15
    assert np.quantile(error, 0.95) < 0.35
    normals = vertex_normals(ball.vertices, ball.triangles)
    cosines = (normals * ball.vertices / radii[:, None]).sum(axis=1)
    assert np.degrees(np.arccos(np.clip(np.median(cosines), -1, 1))) < 6
    assert cosines.min() > 0.5
    assert _euler(ball) == 2
    edges = Counter(map(tuple, ball.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).tolist()))
    assert set(edges.values()) == {1}
    assert all((b, a) in edges for a, b in edges)
    red = ball.vertices[:, 0] > 0.1
    assert (ball.colors[red].argmax(axis=1) == 0).mean() > 0.99
    assert (ball.colors[ball.vertices[:, 0] < -0.1].argmax(axis=1) == 1).mean() > 0.99
    assert ball.facts["volume_bytes"] == ball.facts["blocks"] * BLOCK_BYTES


def test_colours_are_those_of_half_transparent_splats() -> None:
    """Oracle: the colours of the splats, red and green, however much of a pixel they cover."""
    splats = sphere()
    splats = replace(splats, opacities=np.full_like(splats.opacities, -0.8))
    cameras = around(12)
    alpha = render_camera(splats, cameras, 0).alpha[60, 60]
    assert 0.5 < alpha < 0.85
    mesh = make_mesh(splats, cameras, MeshRequest(voxel=VOXEL), threads=1)
    red = mesh.vertices[:, 0] > 0.3
    np.testing.assert_allclose(np.median(mesh.colors[red], axis=0), [0.9, 0.1, 0.1], atol=0.02)


def test_threads_change_no_bits(ball: SurfaceMesh) -> None:
    """Oracle: equality to the bit."""
    again = make_mesh(sphere(), around(), MeshRequest(voxel=VOXEL), threads=2)
    np.testing.assert_array_equal(again.vertices, ball.vertices)
    np.testing.assert_array_equal(again.triangles, ball.triangles)
    np.testing.assert_array_equal(again.colors, ball.colors)


def test_a_box_keeps_its_faces() -> None:
    """Oracle: distances from the box; its edges are rounded within a voxel. The median depth is
    that of the nearest of overlapping splats, so flat sides lie a fraction of a pixel outside."""
    mesh = make_mesh(box(20), around(20), MeshRequest(voxel=0.05, smooth=2), threads=1)
    error = from_box(mesh.vertices) / 0.05
    assert np.median(error) < 0.25
    assert np.quantile(error, 0.95) < 0.7
    assert _euler(mesh) == 2


@pytest.mark.parametrize(("pixels", "steps"), [(4.0, 30), (2.0, 30), (1.0, 120), (0.6, 300)])
def test_smaller_voxels_are_smoothed_over_as_many_pixels(pixels: float, steps: int) -> None:
    """Oracle: the reach of smoothing, voxels times the root of the steps, by hand; the mesh has the
    bits of one with these steps."""
    splats, cameras = sphere(), around(8)
    pixel = make_mesh(splats, cameras, threads=1).facts["voxel"] / 2
    requests = [MeshRequest(voxel=pixels * pixel, smooth=smooth) for smooth in (None, steps)]
    plain, again = (make_mesh(splats, cameras, request, threads=1) for request in requests)
    np.testing.assert_array_equal(again.vertices, plain.vertices)


def test_what_no_camera_sees_is_open_or_closed_on_request() -> None:
    """Oracle: cameras above the equator never see the south pole; a cap closes the sphere."""
    cameras = around(20, least=0.2)
    opened = make_mesh(sphere(), cameras, MeshRequest(voxel=VOXEL, holes="open"), threads=1)
    assert opened.vertices[:, 2].min() > -0.85
    assert max(map(len, boundary_loops(opened.triangles))) > 40
    closed = make_mesh(sphere(), cameras, MeshRequest(voxel=VOXEL, holes="closed"), threads=1)
    assert boundary_loops(closed.triangles) == []
    assert _euler(closed) == 2
    assert len(closed.colors) == len(closed.vertices)
    cosines = (vertex_normals(closed.vertices, closed.triangles) * closed.vertices).sum(axis=1)
    assert (cosines > 0).mean() > 0.95


def test_surfaces_between_thin_parts_have_blocks() -> None:
    """Oracle: a sphere in a cage, whose bars are near every pixel of small pictures."""
    turn = np.repeat(np.arange(120) * (2 * np.pi / 120), 150)
    out = np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    bars = 2.2 * out + np.tile(np.linspace(-2, 2, 150), 120)[:, None] * [0, 0, 1.0]
    scene = joined([sphere(), flat_splats(bars, out, 0.01, np.full_like(bars, 0.2))])
    request = MeshRequest(voxel=0.025, holes="open", min_part=0)
    mesh = make_mesh(scene, around(12, least=-0.3), request, threads=1)
    near = np.abs(np.linalg.norm(mesh.vertices, axis=1) - RADIUS) < 0.025
    distances = KDTree(mesh.vertices[near]).query(sphere(3000).means)[0]
    assert (distances < 0.04).mean() > 0.85  # 0.45 without the pixels beside the bars


def test_a_region_cuts() -> None:
    """Oracle: the box."""
    inside = _mesh(region=np.diag([2.0, 2.0, 0.5, 1.0]))
    assert 0.4 < np.abs(inside.vertices[:, 2]).max() <= 0.5 + VOXEL


def test_masks_cut_what_lies_outside_of_the_subject() -> None:
    """Oracle: a sphere and a ball beside it, which masks of the sphere hide in all pictures; masks
    that only ignore leave what some camera sees beside the sphere."""
    ball = sphere(800)
    small = replace(
        ball,
        means=ball.means * np.float32(0.3) + np.array([1.6, 0, 0], np.float32),
        scales=ball.scales + np.float32(np.log(0.3)),
    )
    both, cameras = joined([sphere(), small]), around()
    alone = [render_camera(sphere(), cameras, i).alpha for i in range(len(cameras))]
    how = {"masks": lambda i: ((alone[i] > 0.5) * 255).astype(np.uint8), "threads": 1}
    request = MeshRequest(voxel=VOXEL)
    largest = {
        mode: make_mesh(both, cameras, request, mask_mode=mode, **how).vertices[:, 0].max()
        for mode in ("none", "composite")
    }
    assert largest["none"] > 1.8
    assert largest["composite"] < RADIUS + VOXEL
    ignoring = make_mesh(sphere(), cameras, request, mask_mode="ignore", **how)
    assert np.median(np.abs(np.linalg.norm(ignoring.vertices, axis=1) - RADIUS)) < 0.3 * VOXEL


def test_reduction_and_views_between(ball: SurfaceMesh) -> None:
    """Oracle: the requested number; the sphere."""
    small = _mesh(triangles=500, between=True)
    assert 450 <= len(small.triangles) <= 500
    assert len(small.colors) == len(small.vertices)
    assert np.abs(np.linalg.norm(small.vertices, axis=1) - RADIUS).max() < VOXEL
    assert small.facts["views"] > ball.facts["views"]


def test_memory_limits_the_volume(ball: SurfaceMesh) -> None:
    """Oracle: the limit; a given voxel size is refused instead of changed."""
    limit = ball.facts["volume_bytes"] / 2
    with pytest.raises(ConfigError, match=r"--voxel 0\.05"):
        _mesh(memory=limit)
    with pytest.raises(ConfigError, match="No voxel fits"):
        make_mesh(sphere(), around(), MeshRequest(memory=1000.0), threads=1)
    request = MeshRequest(memory=limit)
    mesh = make_mesh(sphere(), around(), request, threads=1)
    assert mesh.facts["volume_bytes"] <= limit
    assert np.median(np.abs(np.linalg.norm(mesh.vertices, axis=1) - RADIUS)) < mesh.facts["voxel"]


def test_without_a_surface_smaller_voxels_are_advised(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: the sentence, where contouring finds no triangle."""
    nothing = np.zeros((0, 3)), np.zeros((0, 3), np.int64), np.zeros((0, 3), np.float32)
    module = sys.modules["gscore.mesh.make_mesh"]
    monkeypatch.setattr(module, "contour", lambda *_: nothing)
    with pytest.raises(DatasetError, match=r"with voxels of 0\.5 world units: give a smaller"):
        make_mesh(sphere(), around(4), MeshRequest(voxel=0.5))


def test_bad_input() -> None:
    """Oracle: one error each, which names what is wrong."""
    splats, cameras = sphere(), around(4)
    with pytest.raises(DatasetError, match="no cameras"):
        make_mesh(splats, cameras.subset([]))
    far = MeshRequest(voxel=VOXEL, region=np.diag([0.1, 0.1, 0.1, 1.0]))
    with pytest.raises(DatasetError, match="no surface within"):
        make_mesh(splats, cameras, far)
    with pytest.raises(Cancelled):
        make_mesh(splats, cameras, MeshRequest(voxel=VOXEL), cancelled=lambda: True)
    for name, value in (("voxel", 0), ("far", -1), ("min_part", 2), ("holes", "x"), ("smooth", -1)):
        with pytest.raises(ConfigError, match=f"--{name.replace('_', '-')}"):
            MeshRequest(**{name: value})
