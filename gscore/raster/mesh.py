"""The depth of a triangle mesh as cameras see it, by the native library."""

import ctypes as ct

import numpy as np

from ..errors import ShapeError
from . import _native, header
from .buffers import FLOAT64, INT32, address


def mesh_depth(
    vertices: np.ndarray,
    triangles: np.ndarray,
    K: np.ndarray,
    viewmat: np.ndarray,
    width: int,
    height: int,
) -> np.ndarray:
    """Inverse depth of the nearest triangle at the centre of each pixel.

    Exact along slanted triangles, which may reach behind the camera; both sides of a triangle are
    seen. Takes one thread, so that views can be taken side by side.

    Args:
        vertices: [V, 3] float, world.
        triangles: [T, 3] int32, rows of `vertices`.
        K: [3, 3], pixels; pixel centres lie at +0.5.
        viewmat: [4, 4], world to camera, OpenCV axes.
        width: Of the picture.
        height: Of the picture.

    Returns:
        [H, W] float32, 1/world unit along the camera's z; 0 where there is no triangle.

    Raises:
        ShapeError: an array of another shape, a number that is not finite, or a triangle whose
            corner is not there.
        BackendError: the native library is missing.
    """
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise ShapeError(f"vertices must be [V, 3], got {list(vertices.shape)}.")
    corners = seen_corners(vertices, K, viewmat)
    mesh = header.MeshStruct(
        corner_count=len(corners),
        corners=address("corners", corners, corners.shape, FLOAT64),
        triangle_count=len(triangles),
        triangles=address("triangles", triangles, (len(triangles), 3), INT32),
    )
    out = np.zeros((height, width), np.float32)
    _native.raise_status(
        _native.library().gs_mesh_depth(
            ct.byref(mesh), width, height, address("inverse_depth", out, (height, width))
        )
    )
    return out


def seen_corners(vertices: np.ndarray, K: np.ndarray, viewmat: np.ndarray) -> np.ndarray:
    """[V, 3] float64 (u z, v z, z) of vertices [V, 3] that pixel (u, v) shows at depth z."""
    projection = np.asarray(K, np.float64) @ np.asarray(viewmat, np.float64)[:3]
    seen = np.asarray(vertices, np.float64) @ projection[:, :3].T + projection[:, 3]
    return np.ascontiguousarray(seen)
