"""Random starting points in the views of cameras, by construction."""

import numpy as np
import pytest

from gscore.datasets.points import random_points
from gscore.scene import Cameras
from gscore.transforms import invert_rigid


def _cameras(positions: np.ndarray, forward: np.ndarray) -> Cameras:
    """Cameras at `positions` that face along `forward`, both [C, 3]."""
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    for pose, position, axis in zip(poses, positions, forward, strict=True):
        z = axis / np.linalg.norm(axis)
        x = np.cross([0.3, 1.0, 0.2], z)
        x /= np.linalg.norm(x)
        pose[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
        pose[:3, 3] = position
    count = len(positions)
    return Cameras(
        viewmats=invert_rigid(poses),
        Ks=np.tile(np.array([[80.0, 0, 40], [0, 80, 30], [0, 0, 1]]), (count, 1, 1)),
        widths=np.full(count, 80),
        heights=np.full(count, 60),
        names=tuple(map(str, range(count))),
    )


def _seen(cameras: Cameras, points: np.ndarray) -> np.ndarray:
    """[P] number of cameras that have each point in the picture."""
    out = np.zeros(len(points), int)
    for i in range(len(cameras)):
        in_camera = points @ cameras.viewmats[i, :3, :3].T + cameras.viewmats[i, :3, 3]
        pixels = in_camera @ cameras.Ks[i].T
        pixels = pixels[:, :2] / pixels[:, 2:]
        inside = (pixels > -1e-6) & (pixels < np.array([80, 60]) + 1e-6)
        out += (in_camera[:, 2] > 0) & inside.all(axis=1)
    return out


def test_around_something(rng: np.random.Generator) -> None:
    """Oracle: an orbit of radius 4 around a known point gives a cube of side 4 there."""
    target = np.array([100.0, -20, 5])
    directions = rng.standard_normal((20, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    cameras = _cameras(target + 4 * directions, -directions)
    cloud = random_points(cameras, 5000, seed=1)
    assert np.abs(cloud.points - target).max() <= 2 + 1e-9
    np.testing.assert_allclose(cloud.points.mean(axis=0), target, atol=0.1)
    np.testing.assert_allclose(cloud.points.std(axis=0), 4 / np.sqrt(12), rtol=0.05)
    assert (cloud.colors == 128).all()


@pytest.mark.parametrize("kind", ["forward", "outward", "single"])
def test_elsewhere_all_points_are_seen(kind: str, rng: np.random.Generator) -> None:
    """Oracle: a projection into some camera for every point, no farther than three times the
    spread."""
    positions = rng.uniform(-1, 1, (12, 3))
    forward = np.tile([0.0, 0, 1], (12, 1)) if kind != "outward" else positions
    if kind == "single":
        positions, forward = positions[:1], forward[:1]
    cameras = _cameras(positions, forward)
    points = random_points(cameras, 2000, seed=1).points
    assert (_seen(cameras, points) > 0).all()
    spread = np.linalg.norm(positions - positions.mean(axis=0), axis=1).max() or 1 / 3
    nearest = np.linalg.norm(points[:, None] - positions[None], axis=2).min(axis=1)
    assert nearest.max() < 3 * spread * 1.2  # the corners of a picture are farther than its depth


def test_seed(rng: np.random.Generator) -> None:
    """Oracle: the same points for the same seed, others for another."""
    cameras = _cameras(rng.standard_normal((4, 3)), rng.standard_normal((4, 3)))
    first = random_points(cameras, 10, seed=3).points
    np.testing.assert_array_equal(first, random_points(cameras, 10, seed=3).points)
    assert not np.array_equal(first, random_points(cameras, 10, seed=4).points)
