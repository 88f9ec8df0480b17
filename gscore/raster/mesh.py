"""Mesh depth: the depth of a triangle mesh in cameras, by the native library."""

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
    *,
    near: float = 0.0,
    orthographic: bool = False,
    threads: int = 1,
    out: np.ndarray | None = None,
) -> np.ndarray:
    """Inverse depth of the nearest triangle at the centre of each pixel.

    Exact along slanted triangles, which may extend behind the camera; triangles are two-sided.

    Args:
        vertices: [V, 3] float, world.
        triangles: [T, 3] int32, rows of `vertices`.
        K: [3, 3], px; pixel centres are at +0.5.
        viewmat: [4, 4], world to camera, OpenCV axes.
        width: Of the picture, px.
        height: Of the picture, px.
        near: Near plane: triangles are clipped at this z; world units.
        orthographic: Parallel rays: K's focal lengths are pixels per world unit, x = fx X + cx.
        threads: Threads that draw, for callers that do not render several views in parallel; 0: of
            all cores.
        out: Array for the result, which is allocated otherwise.

    Returns:
        [H, W] float32, 1/world unit along the camera's z; 0 where there is no triangle. With
        parallel rays the error of z is at most 1e-6 of the triangles' extent.

    Raises:
        ShapeError: an array has a wrong shape, a number is not finite, or a triangle has an index
            out of range.
        BackendError: the native library is missing.
    """
    if orthographic:
        out, farthest = mesh_nearness(
            vertices, triangles, K, viewmat, width, height, near=near, threads=threads, out=out
        )
        np.divide(1, np.float64(farthest) - out, out=out, where=out > 0)
        return out
    corners = projected_corners(vertices, K, viewmat)
    return _drawn(corners, triangles, near, width, height, threads, out)


def mesh_backs(
    vertices: np.ndarray,
    triangles: np.ndarray,
    K: np.ndarray,
    viewmat: np.ndarray,
    width: int,
    height: int,
    *,
    orthographic: bool = False,
    threads: int = 1,
) -> np.ndarray | None:
    """Inverse depth of the farthest triangle at the centre of each pixel.

    Arguments and errors as for `mesh_depth`; with parallel rays as `mesh_nearness`.

    Returns:
        [H, W] float32, 0 where there is no triangle; None: a vertex is behind the camera.
    """
    if orthographic:
        corners, _ = _linear(vertices, K, viewmat)
    else:
        corners = projected_corners(vertices, K, viewmat)
    if not len(corners) or corners[:, 2].min() <= 0:
        return None
    # Inverse depths are linear in the picture: turned round, the farthest triangle is the nearest.
    inverse = 1 / corners[:, 2]
    most = 1.001 * float(inverse.max())
    corners *= (inverse / (most - inverse))[:, None]
    drawn = _drawn(corners, triangles, 0.0, width, height, threads, None)
    return np.subtract(np.float32(most), drawn, out=drawn, where=drawn > 0)


def mesh_nearness(
    vertices: np.ndarray,
    triangles: np.ndarray,
    K: np.ndarray,
    viewmat: np.ndarray,
    width: int,
    height: int,
    *,
    near: float = 0.0,
    threads: int = 1,
    out: np.ndarray | None = None,
) -> tuple[np.ndarray, float]:
    """Distance of the nearest triangle in front of a plane behind all, with parallel rays.

    Arguments and errors as for `mesh_depth`. The plane depends on the vertices alone.

    Returns:
        [H, W] float32, world units; 0 where there is no triangle; and z of the plane.
    """
    corners, farthest = _linear(vertices, K, viewmat)
    if near >= farthest:
        triangles = triangles[:0]
    least = 1 / (farthest - near) if near < farthest else 0.0
    return _drawn(corners, triangles, least, width, height, threads, out), farthest


def _drawn(
    corners: np.ndarray,
    triangles: np.ndarray,
    near: float,
    width: int,
    height: int,
    threads: int,
    out: np.ndarray | None,
) -> np.ndarray:
    """gs_mesh_depth of corners [V, 3] and triangles [T, 3]."""
    mesh = header.MeshStruct(
        corner_count=len(corners),
        corners=address("corners", corners, corners.shape, FLOAT64),
        triangle_count=len(triangles),
        triangles=address("triangles", triangles, (len(triangles), 3), INT32),
    )
    out = np.empty((height, width), np.float32) if out is None else out
    depths = address("out", out, (height, width))
    _native.raise_status(
        _native.library().gs_mesh_depth(ct.byref(mesh), near, width, height, threads, depths)
    )
    return out


def _linear(vertices: np.ndarray, K: np.ndarray, viewmat: np.ndarray) -> tuple[np.ndarray, float]:
    """Corners whose inverse depth is their distance in front of a plane, which is linear in an
    orthographic picture; and z of that plane."""
    turned = np.asarray(viewmat, np.float64)[:3].copy()
    turned[:2] = np.asarray(K, np.float64)[:2, :2] @ turned[:2]
    turned[:2, 3] += np.asarray(K, np.float64)[:2, 2]
    corners = projected_corners(vertices, np.eye(3), turned)  # K times (X, Y, 1), and z
    if not len(corners):
        return corners, 1.0
    z = corners[:, 2]
    first, last = float(z.min()), float(z.max())
    farthest = last + max(last - first, abs(first) * 1e-3, abs(last) * 1e-3)
    np.divide(1, farthest - z, out=z)
    corners[:, :2] *= z[:, None]
    return corners, farthest


def projected_corners(vertices: np.ndarray, K: np.ndarray, viewmat: np.ndarray) -> np.ndarray:
    """Homogeneous pixels [V, 3] float64 (u z, v z, z) of vertices [V, 3]."""
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise ShapeError(f"vertices must be [V, 3], got {list(vertices.shape)}.")
    projection = np.asarray(K, np.float64) @ np.asarray(viewmat, np.float64)[:3]
    seen = np.ascontiguousarray(np.asarray(vertices, np.float64) @ projection[:, :3].T)
    for axis in range(3):  # as long loops: sums with a row of three are slow
        seen[:, axis] += projection[axis, 3]
    return seen
