"""Depth of a triangle mesh in float64, each triangle against each pixel as it is defined; slow."""

import numpy as np

from ..mesh import seen_corners


def mesh_depth(
    vertices: np.ndarray,
    triangles: np.ndarray,
    K: np.ndarray,
    viewmat: np.ndarray,
    width: int,
    height: int,
) -> np.ndarray:
    """As `gscore.raster.mesh.mesh_depth`, [H, W] float64.

    The corners weighed by l / z give the ray of a pixel, whose z is 1: one system of three
    equations a triangle.
    """
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = np.stack([x, y, np.ones_like(x)]).reshape(3, -1)
    out = np.zeros(width * height)
    for corners in seen_corners(vertices, K, viewmat)[triangles]:
        if np.linalg.matrix_rank(corners) < 3:
            continue  # a line, or seen edge-on
        shares = np.linalg.solve(corners.T, rays)
        hit = (shares >= 0).all(axis=0)
        out[hit] = np.maximum(out[hit], shares.sum(axis=0)[hit])
    return out.reshape(height, width)
