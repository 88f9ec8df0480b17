"""Grids of depth maps: means over squares, at the right place in the photo, free of fine noise."""

import numpy as np
import pytest

from gscore.depth.posed_depth_map import prepare_depth_map
from gscore.depth.samples import Samples, averaged, grid_step
from gscore.scene import Cameras

WIDTH, HEIGHT = 485, 250
"""Four pixels a square; one column and two rows are left over."""


def test_means_over_squares_of_what_is_known():
    """Oracle: by hand. Squares of two pixels; a half of one is known, a quarter of another."""
    values = np.zeros((2, 241), np.float32)
    values[:, :2] = [[1, 2], [3, 4]]
    values[:, 2:4] = [[5, np.nan], [np.nan, 7]]
    values[:, 4:6] = [[np.nan, np.nan], [9, np.nan]]
    assert grid_step(241) == 2
    found = averaged(values)
    assert found.shape == (1, 120) and found.dtype == np.float32
    np.testing.assert_array_equal(found[0, :4], [2.5, 6, np.nan, 0])
    assert averaged(values[:, :239]).shape == (2, 239)


@pytest.fixture
def plane():
    """A posed depth map that is affine over the photo, with fine noise of 1 % of its range, and the
    map's values at pixels."""

    def stated(x, y):
        return 0.4 * x + 0.1 * y + 3

    rows, columns = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    values = stated(columns, rows)
    values += np.random.default_rng(0).normal(0, 0.01 * np.ptp(values), values.shape)
    K = np.array([[400.0, 0, 200], [0, 410, 120], [0, 0, 1]])
    viewmat = np.eye(4)
    viewmat[:3, 3] = 0.3, -0.2, 0.5
    cameras = Cameras(
        Ks=K[None],
        viewmats=viewmat[None],
        widths=np.array([WIDTH]),
        heights=np.array([HEIGHT]),
        names=("a.png",),
    )
    none = np.zeros(0)
    grid = averaged(values.astype(np.float32))
    samples = Samples(values=none, inverse_depth=none, weights=none, grid=grid)
    return prepare_depth_map(samples, cameras, 0, count=300), stated


def test_sampled_pixels_lie_where_the_map_says(plane):
    """Oracle: the camera's projection, to where the affine map has their tones. An offset of a
    pixel would be 0.002 of its range."""
    found, stated = plane
    local = found.points(np.full(300, 0.5)) @ found.viewmat[:3, :3].T + found.viewmat[:3, 3]
    x, y, _ = (local @ found.K.T / local[:, 2:]).T
    values = found.low + found.tones * (found.high - found.low)
    off = (values - stated(x, y)) / (found.high - found.low)
    assert abs(off.mean()) < 5e-4 and np.abs(off).max() < 0.02


def test_points_are_looked_up_where_they_are_seen(plane):
    """Oracle: the affine map at the pixels of the projected points."""
    found, stated = plane
    rng = np.random.default_rng(1)
    x, y = rng.uniform(10, WIDTH - 10, 500), rng.uniform(10, HEIGHT - 10, 500)
    pixels = np.stack([x, y, np.ones(500)], 1) * rng.uniform(1, 9, 500)[:, None]
    local = pixels @ np.linalg.inv(found.K).T
    tones, inverse = found.look_up((local - found.viewmat[:3, 3]) @ found.viewmat[:3, :3])
    np.testing.assert_allclose(inverse, 1 / local[:, 2])
    off = tones - (stated(x, y) - found.low) / (found.high - found.low)
    assert abs(off.mean()) < 5e-4 and np.abs(off).max() < 0.02


def test_fine_noise_is_no_edge(plane):
    """Oracle: the plane without edges, so pixels are drawn from all of it."""
    assert len(np.unique(plane[0].tones)) > 280
