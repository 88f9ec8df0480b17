"""Additional start points: aligned depth maps back-projected where SfM left holes."""

from collections.abc import Sequence

import numpy as np

from ...scene import Cameras, PointCloud
from ..model.nearest_points import NearestPoints
from ..photos.view_sampler import Photos
from .targets import Prior

_SURE = 0.5
"""Least confidence of a pixel."""
_AGREE = 0.05
"""Largest relative difference to the depth in another view."""
_OTHERS = 4
"""Number of other views, those with the nearest optical axes, that a point is checked in."""
_HOLE = 2.0
"""Least distance of a hole from all points, in grid cells."""


def depth_points(
    photos: Photos,
    priors: Sequence[Prior | None],
    *,
    count: int,
    seed: int,
    most: int | None = None,
) -> PointCloud:
    """Back-project points where SfM has none and two aligned depth maps agree.

    Pixels of a regular grid in each training view are back-projected. A point is kept if it is
    farther than two grid cells from all SfM points, and if the depth in a neighbouring view agrees
    within 5 %; points outside the frames of all neighbouring views are dropped.

    Args:
        photos: The capture; colours come from its photos.
        priors: By index of the view; only aligned ones are used.
        count: Target number of points, which sets the grid; more are thinned at random.
        seed: Seed of the thinning.
        most: Most points, on the same grid; None: `count`.

    Returns:
        0 to `count` points, COLMAP world units.
    """
    cameras = photos.scene.cameras
    used = [i for i in photos.train if (p := priors[i]) is not None and p.aligned]
    if count <= 0 or len(used) < 2:
        return PointCloud(points=np.zeros((0, 3)), colors=np.zeros((0, 3), np.uint8))
    # Four candidates per point, because the checks reject many.
    pixels = sum(int(cameras.widths[i]) * int(cameras.heights[i]) for i in used)
    stride = max(1, int(np.sqrt(pixels / (4 * count))))
    known = NearestPoints(photos.scene.points.points, queries=2 * count)
    parts = [_from_view(photos, priors, used, i, stride, known) for i in used]
    points = np.concatenate([part[0] for part in parts])
    colors = np.concatenate([part[1] for part in parts])
    count = count if most is None else min(count, most)
    if len(points) > count:
        chosen = np.sort(np.random.default_rng(seed).choice(len(points), count, replace=False))
        points, colors = points[chosen], colors[chosen]
    return PointCloud(points=points, colors=colors)


def _from_view(
    photos: Photos,
    priors: Sequence[Prior | None],
    used: list[int],
    index: int,
    stride: int,
    known: NearestPoints,
) -> tuple[np.ndarray, np.ndarray]:
    """Points, [P, 3] world units, and colours, [P, 3] uint8, of one view."""
    cameras, prior = photos.scene.cameras, priors[index]
    assert prior is not None
    rows = np.arange(stride // 2, prior.inverse_depth.shape[0], stride)
    columns = np.arange(stride // 2, prior.inverse_depth.shape[1], stride)
    v, u = (a.ravel() for a in np.meshgrid(rows, columns, indexing="ij"))
    inverse = prior.inverse_depth[v, u].astype(np.float64)
    sure = (prior.confidence[v, u] >= _SURE) & (inverse > 0)
    u, v, depth = u[sure], v[sure], 1 / inverse[sure]
    pixels = np.stack([u + 0.5, v + 0.5, np.ones(len(u))], axis=1)
    rays = pixels @ np.linalg.inv(cameras.Ks[index]).T
    viewmat = cameras.viewmats[index]
    points = (rays * depth[:, None] - viewmat[:3, 3]) @ viewmat[:3, :3]
    cell = stride * depth / cameras.Ks[index, 0, 0]
    keep = _far_from(known, points, _HOLE * cell)
    keep &= _confirmed(cameras, priors, _neighbours(cameras, used, index), points)
    return points[keep], photos.image(index)[v[keep], u[keep]]


def _far_from(known: NearestPoints, points: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """[P] bool: no known point is within `radius` [P]."""
    if len(known) == 0 or len(points) == 0:
        return np.ones(len(points), bool)
    return known.distances(points, 1)[:, 0] > radius


def _neighbours(cameras: Cameras, used: list[int], index: int) -> list[int]:
    """Other views with the optical axes nearest to that of view `index`."""
    axes = cameras.viewmats[:, 2, :3]
    others = [i for i in used if i != index]
    return sorted(others, key=lambda i: -float(axes[i] @ axes[index]))[:_OTHERS]


def _confirmed(
    cameras: Cameras, priors: Sequence[Prior | None], others: list[int], points: np.ndarray
) -> np.ndarray:
    """[P] bool: the depth of the point agrees in one of the other views."""
    confirmed = np.zeros(len(points), bool)
    for i in others:
        prior = priors[i]
        assert prior is not None
        x, y, z = cameras.viewmats[i, :3, :3] @ points.T + cameras.viewmats[i, :3, 3:]
        front = z > 0
        z = np.where(front, z, 1.0)
        K, (height, width) = cameras.Ks[i], prior.inverse_depth.shape
        u, v = K[0, 0] * x / z + K[0, 2], K[1, 1] * y / z + K[1, 2]
        inside = front & (u >= 0) & (u < width) & (v >= 0) & (v < height)
        at = np.where(inside, v, 0).astype(np.int64), np.where(inside, u, 0).astype(np.int64)
        agrees = np.abs(prior.inverse_depth[at] * z - 1) < _AGREE
        confirmed |= inside & (prior.confidence[at] >= _SURE) & agrees
    return confirmed
