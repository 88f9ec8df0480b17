"""Surface of a picture: the plane of each pixel and how much it counts."""

import numpy as np

from ..raster.api import Rendered
from .volume import SurfaceView

_FREE = 0.1
"""Alpha below which a ray meets nothing."""
_SOLID = 0.5
"""Alpha above which it ends at the median depth."""
_WINDOW = 5
"""Side of the filter of depths, px: neighbouring pixels have depths of different splats."""
_PASSES = 2
"""Passes of the filter by planes."""
_BEND = 0.5
"""Least cosine between normals of pixels on one surface."""
_FLATTEST = 0.1
"""Least cosine between ray and normal that counts."""
_STEEPEST = 6.0
"""Largest change of depth between pixels, as a multiple of a pixel's width on the surface: beyond
it there is a silhouette, between whose sides no surface is."""


def surface_view(
    drawn: Rendered,
    K: np.ndarray,
    viewmat: np.ndarray,
    *,
    spread: float,
    far: float,
    mask: np.ndarray | None = None,
    hides: bool = True,
) -> SurfaceView:
    """The surface in a picture.

    The depth is the median one, since the mean of splats in front of and behind the surface lies
    between them. A pixel counts by the square of its cosine, and not at all at a silhouette or
    where the two depths differ much.

    Args:
        drawn: The picture over black, with depths and normals.
        K: [3, 3] px.
        viewmat: [4, 4] world to camera.
        spread: Largest difference of mean and median depth, world units.
        far: Largest depth that counts, world units.
        mask: [H, W], 255 = keep; None: everything is kept.
        hides: Where the mask is less than half, there is nothing; else nothing is known.
    """
    assert drawn.normal is not None
    depth = sure_depth(drawn, K, spread=spread, far=far)
    rays = pixel_rays(K, *depth.shape)
    unit = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    cosine = -(drawn.normal * unit).sum(axis=-1)
    sure = (depth > 0) & (cosine > _FLATTEST)
    free = drawn.alpha < _FREE
    if mask is not None:
        kept = mask >= 128
        sure &= kept
        free = free | ~kept if hides else free & kept
        sure &= ~free
    weight = np.where(free, 1, np.where(sure, cosine * cosine, 0)).astype(np.float32)
    product = (drawn.normal * rays).sum(axis=-1) * depth
    planes = np.concatenate([drawn.normal, product[..., None]], axis=-1).astype(np.float32)
    planes[free] = 0
    return SurfaceView(
        viewmat=np.asarray(viewmat, np.float64),
        K=np.asarray(K, np.float64),
        planes=planes,
        depth=np.where(free, np.inf, depth).astype(np.float32),
        weight=weight,
        rgb=np.clip(drawn.rgb / np.maximum(drawn.alpha, _SOLID)[..., None], 0, 1),
    )


def sure_depth(drawn: Rendered, K: np.ndarray, *, spread: float, far: float) -> np.ndarray:
    """[H, W] float32, median depth, filtered; 0 where there is no surface, or not for sure.

    The median depth is that of a splat's centre. Each pixel gets the mean depth of its neighbours'
    planes on its ray if normals were drawn, else the median of its neighbours.

    Args:
        drawn: The picture with depths, and normals for a better filter.
        K: [3, 3] px.
        spread: Largest difference of mean and median depth, world units.
        far: Largest depth, world units.
    """
    from scipy.ndimage import median_filter

    assert drawn.median_depth is not None
    assert drawn.depth is not None
    if drawn.normal is None:
        depth = median_filter(drawn.median_depth, _WINDOW, mode="nearest")
    else:
        depth = _by_planes(drawn.median_depth, drawn.normal, drawn.alpha > _SOLID, K)
    sure = (drawn.alpha > _SOLID) & (drawn.median_depth > 0) & (depth < far)
    sure &= np.abs(drawn.depth - depth) < spread
    sure &= _slope(depth) < 2 * _STEEPEST * depth / K[0, 0]
    return np.where(sure, depth, 0)


def _by_planes(
    depth: np.ndarray, normal: np.ndarray, known: np.ndarray, K: np.ndarray
) -> np.ndarray:
    """[H, W] float32, at each known pixel the mean depth on its ray of the planes of the pixels
    around it, which its surface is made of: bends by less than `_BEND` and no steps.

    Args:
        depth: [H, W] float32.
        normal: [H, W, 3] float32, unit length, camera axes.
        known: [H, W] bool, pixels that have a plane.
        K: [3, 3] px.
    """
    rows, columns = (np.flatnonzero(known.any(axis=axis)) for axis in (1, 0))
    found = np.array(depth, np.float32)
    if not len(rows):
        return found
    part = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    half = _WINDOW // 2
    x, y = (pixel_rays(K, *depth.shape)[part][..., i] for i in range(2))
    planes = np.pad(np.moveaxis(normal[part], 2, 0), ((0, 0), (half, half), (half, half)))
    height, width = x.shape
    steps = [(j, i) for j in range(_WINDOW) for i in range(_WINDOW)]
    own = planes[:, half : half + height, half : half + width]
    for _ in range(_PASSES):
        at = np.where(known, found, 0)[part]
        reach = at * np.float32(_STEEPEST / K[0, 0])
        offset = np.pad((own[0] * x + own[1] * y + own[2]) * at, half)
        sums, counts = np.zeros_like(at), np.zeros_like(at)
        for j, i in steps:
            window = slice(j, j + height), slice(i, i + width)
            a, b, c = planes[:, *window]
            slope = a * x + b * y + c
            slope[slope > -_FLATTEST] = np.inf
            there = offset[window] / slope
            same = (np.abs(there - at) < reach) & (own[0] * a + own[1] * b + own[2] * c > _BEND)
            sums += np.where(same, there, 0)
            counts += same
        found[part] = np.where(counts > 0, sums / np.maximum(counts, 1), found[part])
    return found


def pixel_rays(K: np.ndarray, height: int, width: int) -> np.ndarray:
    """[H, W, 3] float32, directions of the pixel centres with z = 1, camera axes."""
    (fx, _, cx), (_, fy, cy), _ = K
    rays = np.ones((height, width, 3), np.float32)
    rays[..., 0] = (np.arange(width) + 0.5 - cx) / fx
    rays[..., 1] = ((np.arange(height) + 0.5 - cy) / fy)[:, None]
    return rays


def _slope(depth: np.ndarray) -> np.ndarray:
    """Larger change of depth between the two neighbours of each pixel, across and down."""
    padded = np.pad(depth, 1, mode="edge")
    across = np.abs(padded[1:-1, 2:] - padded[1:-1, :-2])
    return np.maximum(across, np.abs(padded[2:, 1:-1] - padded[:-2, 1:-1]))
