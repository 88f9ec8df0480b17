"""Boxes, ellipsoids and frusta, against conditions written out by hand."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gscore.edit import box_matrix, in_frustum, in_unit_shape, sphere_matrix


@pytest.fixture
def points() -> np.ndarray:
    """[5000, 3] float32 around the origin."""
    return np.random.default_rng(3).normal(0, 2, (5000, 3)).astype(np.float32)


def test_box(points: np.ndarray) -> None:
    """Oracle: comparisons axis by axis; corners belong to the box."""
    low, high = np.array([-1.0, -2.0, 0.5]), np.array([3.0, 1.0, 2.0])
    points = np.concatenate([points, [low, high]])
    wanted = ((points >= low) & (points <= high)).all(axis=1)
    assert 100 < wanted.sum() < 4000 and wanted[-2:].all()
    np.testing.assert_array_equal(in_unit_shape(points, box_matrix(low, high)), wanted)


def test_sphere(points: np.ndarray) -> None:
    """Oracle: distances."""
    center = np.array([0.5, -1.0, 0.25])
    wanted = np.linalg.norm(points - center, axis=1) <= 2.5
    got = in_unit_shape(points, sphere_matrix(center, 2.5), sphere=True)
    assert 100 < wanted.sum() < 4000
    np.testing.assert_array_equal(got, wanted)


def test_frustum(points: np.ndarray) -> None:
    """Oracle: projection with a division by z, for a turned camera with an off-centre principal
    point; splats behind it are outside."""
    K = np.array([[40.0, 0, 12], [0, 50.0, 30], [0, 0, 1]])
    viewmat = np.eye(4)
    viewmat[:3, :3] = Rotation.from_euler("xyz", [0.3, -0.5, 1.0]).as_matrix()
    viewmat[:3, 3] = 0.1, -0.2, 3.0
    seen = points @ viewmat[:3, :3].T + viewmat[:3, 3]
    x = 40 * seen[:, 0] / seen[:, 2] + 12
    y = 50 * seen[:, 1] / seen[:, 2] + 30
    in_picture = (x >= 0) & (x <= 32) & (y >= 0) & (y <= 48)
    wanted = in_picture & (seen[:, 2] > 0.2)
    assert (in_picture & (seen[:, 2] < 0)).any() and 100 < wanted.sum() < 4000
    np.testing.assert_array_equal(in_frustum(points, K, viewmat, 32, 48, 0.2), wanted)
