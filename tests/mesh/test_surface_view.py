"""Depths of pictures. Oracle: planes whose depth at each pixel is known."""

from typing import Any

import numpy as np

from gscore.mesh.surface_view import pixel_rays, sure_depth
from gscore.raster.api import Rendered

K = np.array([[300.0, 0, 32], [0, 300, 24], [0, 0, 1]])
RAYS = pixel_rays(K, 48, 64)


def plane(normal: np.ndarray, distance: float) -> np.ndarray:
    """[H, W], depth of the plane n x = -distance."""
    return -distance / (RAYS @ normal)


def picture(depth: np.ndarray, normal: np.ndarray, alpha: Any = 1.0) -> Rendered:
    shape = depth.shape
    return Rendered(
        rgb=np.zeros((*shape, 3), np.float32),
        alpha=np.broadcast_to(np.float32(alpha), shape),
        inverse_depth=None,
        depth=depth.astype(np.float32),
        visible=1,
        median_depth=depth.astype(np.float32),
        normal=np.broadcast_to(normal, (*shape, 3)).astype(np.float32),
    )


def depth_of(drawn: Rendered) -> np.ndarray:
    return sure_depth(drawn, K, spread=1, far=10)


SLANTED = np.array([0.6, 0, -0.8])


def test_steps_between_splats_vanish_on_a_slanted_plane() -> None:
    """Splats show the depth of their centres: that of the plane, in blocks of pixels."""
    true = plane(SLANTED, 1.6)
    blocks = np.repeat(true[:, 2::5], 5, axis=1)[:, :60]
    stepped = np.concatenate([blocks, true[:, 60:]], axis=1)
    found = depth_of(picture(stepped, SLANTED))
    inner = (slice(4, -4), slice(8, 52))
    error, before = np.abs(found - true)[inner], np.abs(stepped - true)[inner]
    assert error.mean() < 0.3 * before.mean()
    np.testing.assert_allclose(depth_of(picture(true, SLANTED))[inner], true[inner], rtol=1e-5)


def test_an_edge_stays() -> None:
    """Neither a step nor a fold between two surfaces is rounded."""
    near, far = plane(np.array([0, 0, -1.0]), 2.0), plane(np.array([0, 0, -1.0]), 2.5)
    left = np.arange(64) < 32
    found = depth_of(picture(np.where(left, near, far), np.array([0, 0, -1.0])))
    np.testing.assert_allclose(found[:, :30], 2.0, rtol=1e-6)
    np.testing.assert_allclose(found[:, 34:], 2.5, rtol=1e-6)
    normals = np.where(left[None, :, None], SLANTED, SLANTED * [-1, 1, 1])
    fold = np.where(left, plane(SLANTED, 1.6), plane(SLANTED * [-1, 1, 1], 1.6))
    np.testing.assert_allclose(depth_of(picture(fold, normals))[4:-4, 4:-4], fold[4:-4, 4:-4], 1e-5)


def test_pixels_without_a_surface_have_no_say() -> None:
    alpha = np.where(np.arange(64) < 32, 1.0, 0.2)[None]
    true = plane(SLANTED, 1.6)
    found = depth_of(picture(np.where(alpha > 0.5, true, 1.9), SLANTED, alpha))
    np.testing.assert_allclose(found[4:-4, 4:31], true[4:-4, 4:31], rtol=1e-5)
    assert (found[:, 32:] == 0).all()
    assert (depth_of(picture(true, SLANTED, 0.0)) == 0).all()
