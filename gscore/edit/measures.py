"""Measures that choose splats: opacity, size, isolation, contribution; and similarity matrices."""

import math
import os
from collections.abc import Callable, Sequence

import numpy as np

from ..extras import need
from ..raster.blend_weights import GEOMETRY, blending_weights
from ..raster.request import Frustum, Settings
from ..scene import Cameras
from ..splats import Splats


def at_least_opaque(opacities: np.ndarray, least: float) -> np.ndarray:
    """Mask [N] bool of the opacities [N], in [0, 1], of at least `least`."""
    return opacities >= np.float32(least)


def of_size(scales: np.ndarray, least: float = 0.0, most: float = 0.0) -> np.ndarray:
    """Mask [N] bool of the splats with a size between two inclusive limits.

    Args:
        scales: [N, 3] standard deviations, not their logs; the largest of a splat is its size.
        least: Least size, world units.
        most: Largest size, world units; 0: no limit.
    """
    sizes = scales.max(axis=1, initial=-np.inf)
    keep = sizes >= np.float32(least)
    return keep & (sizes <= np.float32(most)) if most > 0 else keep


def similarity_matrix(
    *,
    scale: float = 1.0,
    degrees: Sequence[float] = (0.0, 0.0, 0.0),
    move: Sequence[float] = (0.0, 0.0, 0.0),
) -> np.ndarray:
    """[4, 4] float64 that scales about the origin, then rotates, then translates.

    Args:
        scale: Scale factor.
        degrees: Rotations about the world's x, then y, then z axis, counter-clockwise as seen from
            the end of the axis; multiples of 90 are exact.
        move: Translation, world units.
    """
    matrix = np.eye(4)
    for axis, angle in enumerate(degrees):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        turn = np.eye(4)
        turn[a, a] = turn[b, b] = _cosine(angle)
        turn[b, a], turn[a, b] = _cosine(angle - 90), -_cosine(angle - 90)
        matrix = turn @ matrix
    matrix[:3, :3] *= scale
    matrix[:3, 3] = move
    return matrix


def _cosine(degrees: float) -> float:
    quarters = degrees / 90
    if quarters == round(quarters):
        return (1.0, 0.0, -1.0, 0.0)[round(quarters) % 4]
    return math.cos(math.radians(degrees))


NEIGHBOURS = 8
"""Neighbours per splat."""


def isolation_of(means: np.ndarray, *, threads: int = 0) -> np.ndarray:
    """Isolation of each splat relative to its neighbours.

    The distance to the splat's eighth neighbour, divided by the median of that distance of these
    eight: about 1 inside any object, dense or sparse, and large for single floaters (a simple form
    of the local outlier factor, Breunig et al. 2000).

    Args:
        means: [N, 3], finite.
        threads: 0: all cores; the result does not depend on it.

    Returns:
        [N] float64; 1 for too few splats.

    Raises:
        BackendError: scipy is not installed.
    """
    if len(means) <= NEIGHBOURS:
        return np.ones(len(means))
    spatial = need("scipy.spatial", "Finding isolated splats")
    # Queries in the order of the tree are four times as fast, because neighbours are in cache.
    tree = spatial.KDTree(means, compact_nodes=False, balanced_tree=False)
    order, cores = tree.indices, threads or os.cpu_count() or 1
    distances, near = tree.query(means[order], k=NEIGHBOURS + 1, workers=cores)
    reach = np.empty(len(means))
    reach[order] = distances[:, -1]
    usual = np.empty(len(means))
    usual[order] = np.median(reach[near[:, 1:]], axis=1)
    # Copies in one place have neighbours at distance 0.
    return reach / np.maximum(usual, np.finfo(np.float64).tiny)


def contributions(
    splats: Splats,
    cameras: Cameras,
    *,
    antialias: bool = False,
    near: float = 0.01,
    threads: int = 0,
    on_view: Callable[[int], None] | None = None,
) -> np.ndarray:
    """Largest contribution of each splat to a view.

    The maximum over views, because a splat that one view needs is needed; a sum over views would
    favour the background, which is visible in all.

    Args:
        splats: Raw parameters.
        cameras: Cameras in the same world.
        antialias: As the splats were trained.
        near: Splats with z at or below this are not drawn; world units.
        threads: 0: all cores; the result does not depend on it.
        on_view: Called after each view with the number of views done.

    Returns:
        [N] float32, px: largest sum of its weights in a view; 0: visible in none.

    Raises:
        ShapeError: a camera is invalid.
        BackendError: the native library is missing or out of memory.
    """
    geometry = [np.require(getattr(splats, name), requirements=["C", "A"]) for name in GEOMETRY]
    scratch = {name: np.empty_like(a) for name, a in zip(GEOMETRY, geometry, strict=True)}
    settings = Settings(antialias=antialias, threads=threads)
    most = np.zeros(len(splats), np.float32)
    for i in range(len(cameras)):
        width, height = int(cameras.widths[i]), int(cameras.heights[i])
        view = Frustum(cameras.viewmats[i], cameras.Ks[i], width, height, near)
        shares = np.ones((height, width, 3), np.float32)
        weights = blending_weights(geometry, view, settings, shares, scratch=scratch)
        np.maximum(most, weights[:, 0], out=most)
        if on_view is not None:
            on_view(i + 1)
    return most
