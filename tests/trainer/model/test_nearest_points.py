"""Neighbours among points; oracle: all distances, and the other tree."""

import numpy as np
import pytest

from gscore.scene import PointCloud
from gscore.splats import PARAMETERS
from gscore.trainer.model import nearest_points as module
from gscore.trainer.model.initial_splats import splats_from_points
from gscore.trainer.model.nearest_points import NearestPoints


@pytest.mark.parametrize("asked", [None, 5])
def test_distances_are_the_smallest_of_all(asked: int | None) -> None:
    """Oracle: all distances, sorted, without points that are not finite."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(900, 3))
    points[5], points[6] = np.nan, np.inf
    places = rng.normal(size=(20, 3))
    near = NearestPoints(points, queries=asked)
    assert len(near) == 898
    all_of_them = np.linalg.norm(places[:, None] - near.points[None], axis=2)
    found = near.distances(places, 4)
    np.testing.assert_allclose(found, np.sort(all_of_them, axis=1)[:, :4], rtol=1e-12)
    assert near.distances(places, 1).shape == (20, 1)


def test_both_trees_give_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: splats made with the tree of all points, for few of many, clustered and doubled."""
    rng = np.random.default_rng(1)
    points = np.concatenate(
        [rng.normal(size=(4000, 3)), 1e-6 * rng.normal(size=(4000, 3)) + 3, np.ones((1000, 3))]
    )
    colors = rng.integers(0, 256, points.shape).astype(np.uint8)
    cloud = PointCloud(points=points, colors=colors)
    options = {"extent": 1.0, "opacity": 0.1, "scale": 1.0, "max_splats": 500, "seed": 3}
    quick = splats_from_points(cloud, **options)
    assert NearestPoints(points, queries=500)._build_fast
    monkeypatch.setattr(module, "_MANY", 10**9)
    assert not NearestPoints(points, queries=500)._build_fast
    even = splats_from_points(cloud, **options)
    for name in PARAMETERS:
        np.testing.assert_array_equal(getattr(quick, name), getattr(even, name))
