"""The first splats; oracle: brute-force neighbours and the activation formulas."""

import numpy as np
import pytest

from gscore.errors import DatasetError
from gscore.scene import PointCloud
from gscore.trainer.model.initial_splats import splats_from_points


def cloud(points: np.ndarray) -> PointCloud:
    colors = np.random.default_rng(1).integers(0, 256, points.shape).astype(np.uint8)
    return PointCloud(points=points.astype(np.float64), colors=colors)


OPTIONS = {"extent": 2.0, "opacity": 0.1, "scale": 1.0, "max_splats": 1000, "seed": 0}


def test_size_is_the_distance_to_three_neighbours() -> None:
    """Oracle: all distances, sorted."""
    points = np.random.default_rng(0).normal(size=(40, 3))
    made = splats_from_points(cloud(points), **(OPTIONS | {"scale": 0.5}))
    distances = np.linalg.norm(points[:, None] - points[None], axis=2)
    three = np.sort(distances, axis=1)[:, 1:4]
    expected = 0.5 * np.sqrt((three**2).mean(axis=1))
    np.testing.assert_allclose(np.exp(made.scales), expected[:, None].repeat(3, 1), rtol=1e-5)
    np.testing.assert_allclose(1 / (1 + np.exp(-made.opacities)), 0.1, rtol=1e-6)
    assert made.quats.tolist() == [[1, 0, 0, 0]] * 40


def test_colours_are_those_of_the_points() -> None:
    """Oracle: 0.5 + C0 sh0."""
    points = cloud(np.random.default_rng(0).normal(size=(9, 3)))
    made = splats_from_points(points, **OPTIONS)
    shown = 0.5 + 0.28209479177387814 * made.sh0[:, 0]
    np.testing.assert_allclose(shown * 255, points.colors, atol=1e-4)


def test_points_in_one_place_get_a_size() -> None:
    """Oracle: the floor sqrt(1e-7) of the reference code."""
    made = splats_from_points(cloud(np.zeros((10, 3))), **OPTIONS)
    np.testing.assert_allclose(np.exp(made.scales), np.sqrt(1e-7), rtol=1e-5)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_fewer_points_than_neighbours(count: int) -> None:
    """Oracle: a hundredth of the extent for one point, the distance of 1 for two and three."""
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, np.sqrt(0.75), 0]])[:count]
    made = splats_from_points(cloud(points), **OPTIONS)
    np.testing.assert_allclose(np.exp(made.scales), 0.02 if count == 1 else 1.0, rtol=1e-5)


def test_too_many_points_are_thinned_and_keep_their_size() -> None:
    """Oracle: the splats made of all points, which include each chosen splat."""
    points = cloud(np.random.default_rng(0).normal(size=(100, 3)))
    everything = splats_from_points(points, **OPTIONS)
    some = splats_from_points(points, **(OPTIONS | {"max_splats": 30}))
    assert len(some) == 30
    known = {tuple(m): tuple(s) for m, s in zip(everything.means, everything.scales, strict=True)}
    for mean, scale in zip(some.means, some.scales, strict=True):
        assert known[tuple(mean)] == tuple(scale)


def test_points_that_are_not_finite_are_left_out() -> None:
    """Oracle: the count; without finite points the error, with a remedy."""
    points = np.zeros((4, 3))
    points[1] = np.nan
    points[2] = np.inf
    assert len(splats_from_points(cloud(points), **OPTIONS)) == 2
    with pytest.raises(DatasetError, match="no finite 3D points to start from"):
        splats_from_points(cloud(points[1:3]), **OPTIONS)
