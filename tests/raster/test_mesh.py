"""Depth of meshes; oracles: rays against planes and spheres in closed form, the float64 twin."""

import numpy as np
import pytest

from gscore.errors import BackendError, ShapeError
from gscore.raster import _native, mesh
from tests.raster.twins import mesh as twin

SIZE = 80, 60
K = np.array([[70.0, 0, 41.3], [0, 68.0, 29.2], [0, 0, 1]])


def rays(viewmat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Camera position [3], and the rays of its pixels [H, W, 3], 1 long along its z."""
    x, y = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    local = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(K).T
    return -viewmat[:3, :3].T @ viewmat[:3, 3], local @ viewmat[:3, :3]


def pose(seed: int) -> np.ndarray:
    """A rolled camera some units from the origin, which it faces."""
    rng = np.random.default_rng(seed)
    center = rng.normal(size=3)
    center *= 4 / np.linalg.norm(center)
    z = -center / np.linalg.norm(center)
    x = np.cross(z, rng.normal(size=3))
    x /= np.linalg.norm(x)
    out = np.eye(4)
    out[:3, :3] = [x, np.cross(z, x), z]
    out[:3, 3] = -out[:3, :3] @ center
    return out


def ball(rings: int, segments: int) -> tuple[np.ndarray, np.ndarray]:
    """A sphere of radius 1, of triangles with their corners on it."""
    theta, phi = np.meshgrid(
        np.linspace(0, np.pi, rings + 1), np.linspace(0, 2 * np.pi, segments + 1), indexing="ij"
    )
    points = np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1
    )
    at = np.arange((rings + 1) * (segments + 1), dtype=np.int32).reshape(rings + 1, segments + 1)
    a, b, c, d = at[:-1, :-1], at[:-1, 1:], at[1:, :-1], at[1:, 1:]
    triangles = np.stack([np.stack([a, b, c], -1), np.stack([b, d, c], -1)]).reshape(-1, 3)
    return points.reshape(-1, 3), np.ascontiguousarray(triangles)


@pytest.mark.parametrize("seed", range(6))
def test_a_plane_has_the_depth_of_its_equation(seed: int) -> None:
    """Oracle: 1 / z of the rays on the plane, in closed form; it extends behind the camera."""
    rng = np.random.default_rng(seed)
    viewmat = pose(seed)
    normal, u = rng.normal(size=3), rng.normal(size=3)
    u, v = np.cross(normal, u), np.cross(normal, np.cross(normal, u))
    corners = 0.3 * normal + 1e5 * np.array([u + v, u - v, -u - v, v - u])
    triangles = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    center, towards = rays(viewmat)
    wanted = (towards @ normal) / ((0.3 * normal - center) @ normal)
    found = mesh.mesh_depth(corners, triangles, K, viewmat, *SIZE)
    near = wanted > 1e-3  # beyond, the plane's far end or the horizon
    np.testing.assert_allclose(found[near], wanted[near], rtol=1e-5)
    assert near.any()
    assert (found[wanted <= 0] == 0).all()


@pytest.mark.parametrize("seed", range(3))
def test_a_fine_ball_is_a_sphere(seed: int) -> None:
    """Oracle: the nearer solution of |c + t d| = 1, up to the flatness of the triangles."""
    viewmat = pose(seed)
    center, towards = rays(viewmat)
    a, b = (towards**2).sum(-1), towards @ center
    root = b**2 - a * (center @ center - 1)
    wanted = np.where(root > 0, a / (-b - np.sqrt(np.maximum(root, 0))), 0)
    found = mesh.mesh_depth(*ball(300, 600), K, viewmat, *SIZE)
    inner = root > 0.02
    np.testing.assert_allclose(found[inner], wanted[inner], rtol=2e-4)
    assert inner.sum() > 500
    assert (found[root < 0] == 0).all()


@pytest.mark.parametrize("seed", range(8))
def test_triangles_are_those_of_the_twin(seed: int) -> None:
    """Oracle: the float64 twin, of triangles in front of, next to, behind and through the
    camera."""
    rng = np.random.default_rng(seed)
    vertices = rng.normal(size=(60, 3)) * rng.choice([0.3, 3.0])
    triangles = rng.integers(0, 60, (40, 3)).astype(np.int32)
    viewmat = pose(seed)
    found = mesh.mesh_depth(vertices, triangles, K, viewmat, *SIZE)
    wanted = twin.mesh_depth(vertices, triangles, K, viewmat, *SIZE)
    off = np.abs(found - wanted) > 1e-5 * np.maximum(wanted, 1)
    assert off.sum() <= 2  # a centre on an edge to rounding
    assert (wanted > 0).any()


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("near", [0.0, 2.5])
@pytest.mark.parametrize("seed", range(4))
def test_near_ends_and_parallel_rays_are_those_of_the_twin(
    seed: int, near: float, orthographic: bool
) -> None:
    """Oracle: the float64 twin, which solves for each pixel; triangles are on both sides of it."""
    rng = np.random.default_rng(seed)
    vertices = rng.normal(size=(60, 3)) * 3
    triangles = rng.integers(0, 60, (40, 3)).astype(np.int32)
    viewmat, how = pose(seed), {"near": near, "orthographic": orthographic}
    scale = np.diag([0.15, 0.15, 1]) if orthographic else np.eye(3)
    found = mesh.mesh_depth(vertices, triangles, scale @ K, viewmat, *SIZE, **how)
    wanted = twin.mesh_depth(vertices, triangles, scale @ K, viewmat, *SIZE, **how)
    with np.errstate(divide="ignore"):
        off = ~np.isclose(1 / found, 1 / wanted, rtol=1e-5, atol=1e-5)
    assert off.sum() <= 2  # a centre on an edge to rounding
    assert (wanted > 0).mean() > 0.2
    if near:
        assert found.max() <= 1 / near * (1 + 1e-6)
        assert (found != twin.mesh_depth(vertices, triangles, scale @ K, viewmat, *SIZE)).any()


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_backs_are_those_of_the_farthest_triangle(seed: int, orthographic: bool) -> None:
    """Oracle: each triangle alone; None if a vertex is behind the camera."""
    rng = np.random.default_rng(seed)
    vertices = rng.normal(size=(60, 3)) * 0.6
    triangles = rng.integers(0, 60, (40, 3)).astype(np.int32)
    scale = np.diag([0.4, 0.4, 1]) if orthographic else np.eye(3)
    view = scale @ K, pose(seed), *SIZE
    found = mesh.mesh_backs(vertices, triangles, *view, orthographic=orthographic)
    assert found is not None
    wanted = np.zeros_like(found)
    for one in triangles:
        if orthographic:
            drawn, _ = mesh.mesh_nearness(vertices, one[None], *view)
        else:
            drawn = mesh.mesh_depth(vertices, one[None], *view)
        wanted = np.where((wanted == 0) | ((drawn > 0) & (drawn < wanted)), drawn, wanted)
    off = ~np.isclose(found, wanted, rtol=1e-5, atol=1e-6)
    assert off.sum() <= 2  # a centre on an edge to rounding
    assert (wanted > 0).mean() > 0.1
    behind = vertices + 5 * rng.normal(size=(60, 3))
    if not orthographic:
        assert mesh.mesh_backs(behind, triangles, *view) is None


def test_threads_and_instruction_sets_give_the_same_bits(isa: str) -> None:
    """Oracle: a single thread with the portable kernels; the result is in the array given."""
    rng = np.random.default_rng(3)
    vertices, viewmat = rng.normal(size=(60, 3)) * 3, pose(3)
    mesh_given = vertices, rng.integers(0, 60, (90, 3)).astype(np.int32), K, viewmat, *SIZE
    out = np.full(SIZE[::-1], np.nan, np.float32)
    for how in ({}, {"near": 1.5}, {"near": 1.5, "orthographic": True}):
        _native.set_isa("scalar")
        wanted = mesh.mesh_depth(*mesh_given, **how)
        _native.set_isa(isa)
        for threads in (1, 3, 0):
            assert mesh.mesh_depth(*mesh_given, **how, threads=threads, out=out) is out
            np.testing.assert_array_equal(out, wanted)


def test_neighbours_leave_no_crack() -> None:
    """Oracle: a hit by every ray into a closed ball, for edges at any place."""
    for seed in range(20):
        viewmat = pose(seed)
        center, towards = rays(viewmat)
        a, b = (towards**2).sum(-1), towards @ center
        inside = b**2 - a * (center @ center - 1) > 0.3
        found = mesh.mesh_depth(*ball(17, 23), K, viewmat, *SIZE)
        assert (found[inside] > 0).all()


def test_invalid_meshes_are_refused() -> None:
    """Oracle: the docstring; missing indices would read out of bounds."""
    vertices, triangles = np.eye(3), np.array([[0, 1, 2]], np.int32)
    viewmat = pose(0)
    for bad in (3, -1):
        with pytest.raises(ShapeError, match="has corner index"):
            mesh.mesh_depth(vertices, np.array([[0, 1, bad]], np.int32), K, viewmat, *SIZE)
    with pytest.raises(ShapeError, match="not finite"):
        mesh.mesh_depth(vertices * np.nan, triangles, K, viewmat, *SIZE)
    with pytest.raises(ShapeError, match="int32"):
        mesh.mesh_depth(vertices, triangles.astype(np.int64), K, viewmat, *SIZE)
    with pytest.raises((ShapeError, BackendError), match="65536"):
        mesh.mesh_depth(vertices, triangles, K, viewmat, 70_000, 1)
    empty = mesh.mesh_depth(vertices[:0], triangles[:0], K, viewmat, *SIZE)
    assert empty.shape == (SIZE[1], SIZE[0]) and not empty.any()
