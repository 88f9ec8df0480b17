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
"""Largest relative difference to the depth that another view states for the point."""
_OTHERS = 4
"""Views with the nearest axes that are asked."""
_HOLE = 2.0
"""A hole is farther from all points than this many pixels of the grid."""


def depth_points(
    photos: Photos,
    priors: Sequence[Prior | None],
    *,
    count: int,
    seed: int,
    most: int | None = None,
) -> PointCloud:
    """Points where SfM has none, seen alike by two aligned depth maps.

    Pixels of an even grid in each training view are back-projected. A point stays if it is farther
    from all SfM points than two grid cells, and if a neighbouring view whose frame it lies in
    states its depth within 5 % there; points that no other view can judge are left out.

    Args:
        photos: The capture; colours come from its photos.
        priors: By index of the view; only aligned ones are used.
        count: Sets how fine the grid is; at most so many, thinned at random.
        seed: Of the thinning.
        most: At most so many on the same grid; None: `count`.

    Returns:
        0 to `count` points in COLMAP world.
    """
    cameras = photos.scene.cameras
    used = [i for i in photos.train if (p := priors[i]) is not None and p.aligned]
    if count <= 0 or len(used) < 2:
        return PointCloud(points=np.zeros((0, 3)), colors=np.zeros((0, 3), np.uint8))
    # Twice as many candidates as wanted in all, or the checks would leave too few.
    pixels = sum(int(cameras.widths[i]) * int(cameras.heights[i]) for i in used)
    stride = max(1, int(np.sqrt(pixels / (4 * count))))
    known = NearestPoints(photos.scene.points.points, asked=2 * count)
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
    """Points [P, 3] and colours [P, 3] of one view."""
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
    """[P] bool: none of the known points lies within `radius` [P]."""
    if len(known) == 0 or len(points) == 0:
        return np.ones(len(points), bool)
    return known.distances(points, 1)[:, 0] > radius


def _neighbours(cameras: Cameras, used: list[int], index: int) -> list[int]:
    """The other views whose optical axes are nearest to that of view `index`."""
    axes = cameras.viewmats[:, 2, :3]
    others = [i for i in used if i != index]
    return sorted(others, key=lambda i: -float(axes[i] @ axes[index]))[:_OTHERS]


def _confirmed(
    cameras: Cameras, priors: Sequence[Prior | None], others: list[int], points: np.ndarray
) -> np.ndarray:
    """[P] bool: one of the other views states the same depth for the point."""
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
