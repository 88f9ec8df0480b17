"""Points from depth maps; oracle: a sphere in front of the toy cameras, known at every pixel."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from gscore.depth import DepthPrior
from gscore.scene import PointCloud
from gscore.trainer.depth.setup import depth_points

RADIUS = 0.8


def sphere(cameras: Any, index: int, radius: float = RADIUS) -> DepthPrior:
    """Inverse depth of a sphere around the origin in camera `index`."""
    K, viewmat = cameras.Ks[index], cameras.viewmats[index]
    x = np.arange(cameras.widths[index]) + 0.5
    y = np.arange(cameras.heights[index]) + 0.5
    pixels = np.stack([*np.meshgrid(x, y), np.ones((len(y), len(x)))], -1)
    rays = pixels @ np.linalg.inv(K).T
    center = viewmat[:3, 3]  # of the sphere, in the camera
    a, b = (rays**2).sum(-1), rays @ center
    inside = b**2 - a * (center @ center - radius**2)
    depth = (b - np.sqrt(np.maximum(inside, 0))) / a
    hit = inside > 0
    return DepthPrior(
        inverse_depth=np.where(hit, 1 / depth, 0).astype(np.float32),
        confidence=hit.astype(np.float32),
        aligned=True,
        fit=None,
    )


@pytest.fixture
def photos(make_photos: Callable[..., Any]) -> Any:
    """The toy capture with a single SfM point far away, view 3 held out."""
    out = make_photos(held_out=(3,))
    points = PointCloud(points=np.full((1, 3), 50.0), colors=np.zeros((1, 3), np.uint8))
    out.scene = type(out.scene)(cameras=out.scene.cameras, points=points)
    return out


def priors_of(photos: Any) -> list[DepthPrior | None]:
    return [sphere(photos.scene.cameras, i) for i in range(8)]


def test_points_lie_on_the_surface(photos: Any) -> None:
    """Oracle: the distance to the origin; the colours of the photo."""
    found = depth_points(photos, priors_of(photos), count=500, seed=0)
    assert 200 <= len(found) <= 500
    assert np.abs(np.linalg.norm(found.points, axis=1) - RADIUS).max() < 1e-3
    view = photos.scene.cameras.viewmats[0]
    # From all sides, not from one view alone.
    z = found.points @ view[2, :3] + view[2, 3]
    assert z.min() < np.linalg.norm(view[:3, 3]) < z.max()
    colors = np.concatenate([photos.image(i).reshape(-1, 3) for i in photos.train])
    assert set(map(tuple, found.colors.tolist())) <= set(map(tuple, colors.tolist()))


def test_no_points_are_added_next_to_sfm_points(photos: Any) -> None:
    """Oracle: a dense half sphere of SfM points; new points stay on the other half."""
    normals = np.random.default_rng(0).normal(size=(20_000, 3))
    points = RADIUS * normals / np.linalg.norm(normals, axis=1, keepdims=True)
    half = points[points[:, 0] > 0]
    cloud = PointCloud(points=half, colors=np.zeros((len(half), 3), np.uint8))
    photos.scene = type(photos.scene)(cameras=photos.scene.cameras, points=cloud)
    found = depth_points(photos, priors_of(photos), count=400, seed=0)
    assert len(found) > 50
    assert found.points[:, 0].max() < 0.1


def test_unconfirmed_points_are_rejected(photos: Any) -> None:
    """Oracle: one map of another sphere and refused maps, whose points are all rejected."""
    priors = priors_of(photos)
    priors[0] = sphere(photos.scene.cameras, 0, radius=0.4)
    found = depth_points(photos, priors, count=500, seed=0)
    assert len(found) > 100
    assert np.abs(np.linalg.norm(found.points, axis=1) - RADIUS).max() < 0.05
    refused = [
        DepthPrior(inverse_depth=p.inverse_depth, confidence=p.confidence, aligned=False, fit=None)
        for p in priors_of(photos)
        if p is not None
    ]
    assert len(depth_points(photos, refused, count=500, seed=0)) == 0
    assert len(depth_points(photos, priors_of(photos), count=0, seed=0)) == 0


def test_held_out_views_do_not_help(photos: Any) -> None:
    """Oracle: the same points with and without a map of the held-out view."""
    priors = priors_of(photos)
    whole = depth_points(photos, priors, count=300, seed=1)
    priors[3] = None
    without = depth_points(photos, priors, count=300, seed=1)
    np.testing.assert_array_equal(whole.points, without.points)
