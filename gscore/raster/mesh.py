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
) -> np.ndarray:
    """Inverse depth of the nearest triangle at the centre of each pixel.

    Exact along slanted triangles, which may extend behind the camera; triangles are two-sided.
    Single-threaded, so that callers can render several views in parallel.

    Args:
        vertices: [V, 3] float, world.
        triangles: [T, 3] int32, rows of `vertices`.
        K: [3, 3], px; pixel centres are at +0.5.
        viewmat: [4, 4], world to camera, OpenCV axes.
        width: Of the picture, px.
        height: Of the picture, px.
        near: Near plane: triangles are clipped at this z; world units.
        orthographic: Parallel rays: K's focal lengths are pixels per world unit, x = fx X + cx.

    Returns:
        [H, W] float32, 1/world unit along the camera's z; 0 where there is no triangle. With
        parallel rays the error of z is at most 1e-6 of the triangles' extent.

    Raises:
        ShapeError: an array has a wrong shape, a number is not finite, or a triangle has an index
            out of range.
        BackendError: the native library is missing.
    """
    if orthographic:
        out, farthest = mesh_nearness(vertices, triangles, K, viewmat, width, height, near=near)
        np.divide(1, np.float64(farthest) - out, out=out, where=out > 0)
        return out
    _check(vertices)
    if near > 0:
        corners, triangles = _before(near, vertices, triangles, viewmat)
        corners = corners @ np.asarray(K, np.float64).T
    else:
        corners = projected_corners(vertices, K, viewmat)
    return _drawn(corners, triangles, width, height)


def mesh_nearness(
    vertices: np.ndarray,
    triangles: np.ndarray,
    K: np.ndarray,
    viewmat: np.ndarray,
    width: int,
    height: int,
    *,
    near: float = 0.0,
) -> tuple[np.ndarray, float]:
    """Distance of the nearest triangle in front of a plane behind all, with parallel rays.

    Arguments and errors as for `mesh_depth`. The plane depends on the vertices alone if all are
    beyond `near`.

    Returns:
        [H, W] float32, world units; 0 where there is no triangle; and z of the plane.
    """
    _check(vertices)
    corners, triangles = _before(near, vertices, triangles, viewmat)
    corners, farthest = _linear(corners @ np.asarray(K, np.float64).T, K)
    return _drawn(corners, triangles, width, height), farthest


def _check(vertices: np.ndarray) -> None:
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise ShapeError(f"vertices must be [V, 3], got {list(vertices.shape)}.")


def _drawn(corners: np.ndarray, triangles: np.ndarray, width: int, height: int) -> np.ndarray:
    """gs_mesh_depth of corners [V, 3] and triangles [T, 3]."""
    mesh = header.MeshStruct(
        corner_count=len(corners),
        corners=address("corners", corners, corners.shape, FLOAT64),
        triangle_count=len(triangles),
        triangles=address("triangles", triangles, (len(triangles), 3), INT32),
    )
    out = np.empty((height, width), np.float32)
    _native.raise_status(
        _native.library().gs_mesh_depth(
            ct.byref(mesh), width, height, address("inverse_depth", out, (height, width))
        )
    )
    return out


def _before(
    near: float, vertices: np.ndarray, triangles: np.ndarray, viewmat: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Triangles clipped at z = near: vertices [V', 3] in the camera's axes, and [T', 3] int32."""
    address("triangles", triangles, (len(triangles), 3), INT32)
    if triangles.size and (triangles.min() < 0 or triangles.max() >= len(vertices)):
        raise ShapeError(f"triangles has indices out of range, expected 0 to {len(vertices) - 1}.")
    places = projected_corners(vertices, np.eye(3), viewmat)
    there = places[:, 2] >= near
    kept = there[triangles]
    count = kept.sum(1)
    whole = triangles[count == 3]
    # Rotated so that the single corner on its side of the plane comes first.
    tip, stump = triangles[count == 1], triangles[count == 2]
    tip, stump = (
        _turned(tip, kept[count == 1].argmax(1)),
        _turned(stump, kept[count == 2].argmin(1)),
    )
    ends = np.concatenate([tip[:, [0, 1]], tip[:, [0, 2]], stump[:, [1, 0]], stump[:, [2, 0]]])
    inside, outside = places[ends[:, 0]], places[ends[:, 1]]
    share = (near - inside[:, 2:]) / (outside[:, 2:] - inside[:, 2:])
    cuts = inside + share * (outside - inside)
    cuts[:, 2] = near
    at = np.split(len(places) + np.arange(len(ends)), np.cumsum([len(tip)] * 2 + [len(stump)]))
    parts = [
        whole,
        np.stack([tip[:, 0], at[0], at[1]], 1),
        np.stack([stump[:, 1], stump[:, 2], at[3]], 1),
        np.stack([stump[:, 1], at[3], at[2]], 1),
    ]
    return np.concatenate([places, cuts]), np.concatenate(parts).astype(np.int32)


def _turned(triangles: np.ndarray, first: np.ndarray) -> np.ndarray:
    """[T, 3] rotated so that corner `first` [T] comes first; the orientation is kept."""
    return np.take_along_axis(triangles, (first[:, None] + np.arange(3)) % 3, 1)


def _linear(corners: np.ndarray, K: np.ndarray) -> tuple[np.ndarray, float]:
    """Corners whose inverse depth is their distance in front of a plane, which is linear in an
    orthographic picture; and z of that plane."""
    z = corners[:, 2]
    if not len(z):
        return corners, 1.0
    center = np.asarray(K, np.float64)[:2, 2]
    places = corners[:, :2] - z[:, None] * center + center  # K times (X, Y, 1)
    farthest = float(z.max() + max(np.ptp(z), abs(z).max() * 1e-3))
    weight = 1 / (farthest - z)
    return np.column_stack([places * weight[:, None], weight]), farthest


def projected_corners(vertices: np.ndarray, K: np.ndarray, viewmat: np.ndarray) -> np.ndarray:
    """Homogeneous pixels [V, 3] float64 (u z, v z, z) of vertices [V, 3]."""
    projection = np.asarray(K, np.float64) @ np.asarray(viewmat, np.float64)[:3]
    seen = np.asarray(vertices, np.float64) @ projection[:, :3].T + projection[:, 3]
    return np.ascontiguousarray(seen)
