"""Rotations, axis flips and the training world against scipy and direct projection."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gscore.errors import ShapeError
from gscore.scene import NEAR, Cameras, splat_near
from gscore.splats import Splats
from gscore.transforms import (
    Similarity,
    invert_rigid,
    opengl_from_viewmat,
    quat_to_rotmat,
    rotmat_to_quat,
    viewmat_from_opengl,
)


def _poses(rng: np.random.Generator, count: int) -> np.ndarray:
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = Rotation.random(count, rng=rng).as_matrix()
    poses[:, :3, 3] = rng.normal(0, 5, (count, 3))
    return poses


def test_rotation_matrices_equal_scipy(rng: np.random.Generator) -> None:
    """Oracle: scipy's Rotation, on quaternions of any length."""
    quats = rng.standard_normal((100, 4)) * rng.uniform(1e-3, 1e3, (100, 1))
    expected = Rotation.from_quat(quats, scalar_first=True).as_matrix()
    np.testing.assert_allclose(quat_to_rotmat(quats), expected, atol=1e-14)


def test_quaternions_equal_scipy(rng: np.random.Generator) -> None:
    """Oracle: scipy's Rotation, including half turns where w vanishes."""
    turns = [
        Rotation.random(100, rng=rng).as_matrix(),
        Rotation.from_rotvec(np.pi * np.eye(3)).as_matrix(),
        np.eye(3)[None],
    ]
    matrices = np.concatenate(turns)
    quats = rotmat_to_quat(matrices)
    assert (quats[:, 0] >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(quats, axis=1), 1, atol=1e-14)
    again = Rotation.from_quat(quats, scalar_first=True).as_matrix()
    np.testing.assert_allclose(again, matrices, atol=1e-14)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(-1, 1), min_size=3, max_size=3))
def test_quaternion_near_half_turns(vector: list[float]) -> None:
    """Oracle: the matrix itself, for rotations within 1e-6 of a half turn."""
    axis = np.array(vector)
    norm = np.linalg.norm(axis)
    if norm < 1e-3:
        return
    matrix = Rotation.from_rotvec(axis / norm * (np.pi - 1e-6)).as_matrix()
    np.testing.assert_allclose(quat_to_rotmat(rotmat_to_quat(matrix)), matrix, atol=1e-14)


def test_inverse_is_inverse(rng: np.random.Generator) -> None:
    """Oracle: numpy's general inverse."""
    poses = _poses(rng, 20)
    np.testing.assert_allclose(invert_rigid(poses), np.linalg.inv(poses), atol=1e-12)


def test_opengl_axes() -> None:
    """Oracle: a camera at the origin of Blender that faces along its -z with +y up."""
    viewmat = viewmat_from_opengl(np.eye(4))
    point = np.array([0.25, 1.0, -4.0, 1.0])  # in front, above, to the right
    x, y, z, _ = viewmat @ point
    assert (x, y, z) == (0.25, -1.0, 4.0)  # OpenCV: right, above is negative, in front is positive


def test_opengl_round_trip(rng: np.random.Generator) -> None:
    """Oracle: identity after both ways, and the same centre."""
    viewmats = _poses(rng, 20)
    world_from_camera = opengl_from_viewmat(viewmats)
    centers = -np.einsum("cji,cj->ci", viewmats[:, :3, :3], viewmats[:, :3, 3])
    np.testing.assert_allclose(world_from_camera[:, :3, 3], centers, atol=1e-12)
    np.testing.assert_allclose(viewmat_from_opengl(world_from_camera), viewmats, atol=1e-12)


@pytest.fixture
def cameras(rng: np.random.Generator) -> Cameras:
    viewmats = _poses(rng, 5)
    # Far from the origin, as georeferenced models are.
    viewmats[:, :3, 3] -= viewmats[:, :3, :3] @ np.array([4e5, 5e6, 100.0])
    return Cameras(
        viewmats=viewmats,
        Ks=np.tile(np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]]), (5, 1, 1)),
        widths=np.full(5, 640),
        heights=np.full(5, 480),
        names=tuple("abcde"),
    )


def test_similarity_leaves_pictures_unchanged(cameras: Cameras, rng: np.random.Generator) -> None:
    """Oracle: the projections of points in the original world."""
    world = cameras.centers.mean(axis=0) + rng.normal(0, 3, (50, 3))
    similarity = Similarity.fit(cameras.centers)
    trained = similarity.cameras_to_training(cameras)
    points = similarity.points_to_training(world)
    for i in range(len(cameras)):
        before = world @ cameras.viewmats[i, :3, :3].T + cameras.viewmats[i, :3, 3]
        after = points @ trained.viewmats[i, :3, :3].T + trained.viewmats[i, :3, 3]
        np.testing.assert_allclose(after, before * similarity.scale, atol=1e-8)


def test_similarity_brings_cameras_close(cameras: Cameras) -> None:
    """Oracle: the documented radius of 1, and a power of two as scale."""
    similarity = Similarity.fit(cameras.centers)
    centers = similarity.points_to_training(cameras.centers)
    radius = np.linalg.norm(centers, axis=1).max()
    assert 0.5 < radius <= 1
    assert np.log2(similarity.scale) == round(np.log2(similarity.scale))


def test_similarity_is_undone(cameras: Cameras, rng: np.random.Generator) -> None:
    """Oracle: identity; splats to float32 rounding of the world position, rotations to the bit."""
    similarity = Similarity(scale=0.125, shift=np.array([10.0, -20.0, 30.0]))
    again = similarity.cameras_from_training(similarity.cameras_to_training(cameras))
    np.testing.assert_allclose(again.viewmats, cameras.viewmats, rtol=1e-12, atol=1e-8)

    def normal(*shape: int) -> np.ndarray:
        return rng.standard_normal(shape, dtype=np.float32)

    splats = Splats(
        means=normal(40, 3),
        quats=normal(40, 4),
        scales=normal(40, 3),
        opacities=normal(40),
        sh0=normal(40, 1, 3),
        shN=normal(40, 15, 3),
    )
    trained = similarity.splats_to_training(splats)
    expected = (splats.means.astype(np.float64) - similarity.shift) * 0.125
    np.testing.assert_allclose(trained.means, expected, rtol=1e-7)
    np.testing.assert_allclose(np.exp(trained.scales), np.exp(splats.scales) * 0.125, rtol=1e-6)
    back = similarity.splats_from_training(trained)
    np.testing.assert_allclose(back.means, splats.means, atol=4e-6)
    np.testing.assert_allclose(back.scales, splats.scales, atol=5e-7)
    for name in ("quats", "opacities", "sh0", "shN"):
        np.testing.assert_array_equal(getattr(back, name), getattr(splats, name))


@pytest.mark.parametrize("centers", [np.zeros((0, 3)), np.ones((1, 3)), np.ones((4, 3)) * 1e6])
def test_similarity_without_extent(centers: np.ndarray) -> None:
    """Oracle: a scale of 1 without an extent."""
    similarity = Similarity.fit(centers)
    assert similarity.scale == 1
    np.testing.assert_array_equal(similarity.points_to_training(centers), np.zeros(centers.shape))


@pytest.mark.parametrize("far", [1e200, 1e308, np.inf, np.nan])
def test_similarity_refuses_what_would_overflow(far: float) -> None:
    """Oracle: one error of ours, no other and no warning of numpy."""
    with pytest.raises(ShapeError, match="centers must be finite and within 1e"):
        Similarity.fit(np.array([[0.0, 0, 0], [far, 0, 0]]))


@pytest.mark.parametrize("size", [1e-310, 1e-31, 1e-29, 1.0, 1e29])
def test_similarity_of_any_size(size: float) -> None:
    """Oracle: a radius of at most 1, and more than half of it unless there is no length."""
    centers = np.array([[0.0, 0, 0], [size, 0, 0]])
    radius = np.abs(Similarity.fit(centers).points_to_training(centers)).max()
    assert radius < 1e-29 if size < 1e-30 else 0.5 <= radius <= 1


@pytest.mark.parametrize("scale", [0.0, -1.0, np.nan, np.inf])
def test_similarity_refuses(scale: float) -> None:
    """Oracle: the refusal of a scale that is not positive and finite."""
    with pytest.raises(ShapeError, match="scale"):
        Similarity(scale=scale, shift=np.zeros(3))


@pytest.mark.parametrize("power", [-135, 0, 120])
@pytest.mark.filterwarnings("error")
def test_quaternions_of_any_length_have_rotations(power: int) -> None:
    """Oracle: the rotations of the same quaternions at lengths about 1."""
    quats = np.random.default_rng(0).integers(-99, 99, (200, 4)).astype(np.float32) / 64
    assert np.array_equal(quat_to_rotmat(np.ldexp(quats, power)), quat_to_rotmat(quats))


@pytest.mark.filterwarnings("error")
def test_the_near_plane_of_splats_at_the_end_of_float32() -> None:
    """Oracle: no warning of numpy, and the default."""
    means = np.full((10, 3), -3e38, np.float32)
    assert splat_near(means) == NEAR
