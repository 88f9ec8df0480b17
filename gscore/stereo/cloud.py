"""Stereo point cloud: points on the surfaces of the depth maps, evenly thinned."""

import numpy as np

from ..scene import PointCloud
from .maps import StereoMap, StereoMaps

_ROUNDS = 24
"""Bisection steps for the cell size."""
_A_POINT = 12
"""Number of pixels read per point; rows and columns are skipped if there are more."""
_LARGEST = 64.0
"""Largest cell, px."""


def dense_points(maps: StereoMaps, *, most: int) -> PointCloud:
    """At most `most` points, one per cell of space; the cell size in photo pixels is uniform.

    A point is the mean position and colour of all map pixels in its cell, so views that agree share
    a point. Cell sizes grow with the distance to the photo in powers of two.
    """
    if not maps.maps or most <= 0:
        return PointCloud.none()
    known = sum(int((found.inverse_depth > 0).sum()) for found in maps.maps.values())
    step = max(1, int((known / (_A_POINT * most)) ** 0.5))
    parts = [_of_map(found, step) for found in maps.maps.values()]
    points, colors, footprints = (np.concatenate(column) for column in zip(*parts, strict=True))
    if len(points) == 0:
        return PointCloud.none()
    low, high = 0.0, np.log2(_LARGEST)
    cells = _cells(points, footprints, 2.0**high)
    for _ in range(_ROUNDS):
        middle = 0.5 * (low + high)
        tried = _cells(points, footprints, 2.0**middle)
        if tried.max() < most:
            high, cells = middle, tried
        else:
            low = middle
        if 0.97 * most < cells.max() + 1 <= most:
            break
    if cells.max() >= most:
        keep = cells < most
        points, colors, cells = points[keep], colors[keep], cells[keep]
    count = np.bincount(cells)
    places = np.stack([np.bincount(cells, points[:, k]) / count for k in range(3)], axis=1)
    tones = np.stack([np.bincount(cells, colors[:, k]) / count for k in range(3)], axis=1)
    return PointCloud(points=places, colors=np.rint(tones).astype(np.uint8))


def _of_map(found: StereoMap, step: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points [P, 3] in the world, colours [P, 3] and pixel sizes [P], world units, from every
    `step`-th row and column."""
    view = found.photo.view
    v, u = (step * a for a in np.nonzero(found.inverse_depth[::step, ::step] > 0))
    depth = 1 / found.inverse_depth[v, u].astype(np.float64)
    pixels = np.stack([u + 0.5, v + 0.5, np.ones(len(u))], axis=1)
    rays = pixels @ np.linalg.inv(view.K).T
    points = (rays * depth[:, None] - view.viewmat[:3, 3]) @ view.viewmat[:3, :3]
    return points, found.photo.rgb[v, u], depth / view.K[0, 0]


def _cells(points: np.ndarray, footprints: np.ndarray, size: float) -> np.ndarray:
    """Cell index [P] of each point, from 0; cells are `size` to 2 * `size` pixels large."""
    level = np.ceil(np.log2(footprints * size))
    places = np.floor(points / np.exp2(level)[:, None]).astype(np.int64)
    keys = np.column_stack([level.astype(np.int64), places])
    packed = np.zeros(len(keys), np.uint64)
    with np.errstate(over="ignore"):
        for column in keys.T:  # a hash: rare collisions only merge two cells
            packed = (packed ^ column.astype(np.uint64)) * np.uint64(0x9E3779B97F4A7C15)
            packed ^= packed >> np.uint64(29)
    return np.unique(packed, return_inverse=True)[1]
