"""Surface of a picture: the plane of each pixel and how much it counts."""

import numpy as np

from ..raster.api import Rendered
from .volume import SurfaceView

_FREE = 0.1
"""Alpha below which a ray meets nothing."""
_SOLID = 0.5
"""Alpha above which it ends at the median depth."""
_WINDOW = 5
"""Side of the median filter of depths, px: neighbouring pixels have depths of different splats."""
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

    Args:
        drawn: The picture with depths.
        K: [3, 3] px.
        spread: Largest difference of mean and median depth, world units.
        far: Largest depth, world units.
    """
    from scipy.ndimage import median_filter

    assert drawn.median_depth is not None
    assert drawn.depth is not None
    depth = median_filter(drawn.median_depth, _WINDOW, mode="nearest")
    sure = (drawn.alpha > _SOLID) & (drawn.median_depth > 0) & (depth < far)
    sure &= np.abs(drawn.depth - depth) < spread
    sure &= _slope(depth) < 2 * _STEEPEST * depth / K[0, 0]
    return np.where(sure, depth, 0)


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
