"""Reference mesh depth in float64, each triangle against each pixel by definition; slow."""

import numpy as np

from gscore.raster.mesh import projected_corners


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
    """Like `gscore.raster.mesh.mesh_depth`, [H, W] float64.

    The corners weighted by l / z give the ray of a pixel, with z = 1: one 3 x 3 system per
    triangle. With parallel rays, K times (X, Y, 1) weighted by l gives the pixel.
    """
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = np.stack([x, y, np.ones_like(x)]).reshape(3, -1)
    out = np.zeros(width * height)
    places = projected_corners(vertices, np.eye(3), viewmat)
    depths = places[:, 2].copy()
    if orthographic:
        places[:, 2] = 1
    for rows in triangles:
        corners = places[rows] @ np.asarray(K, np.float64).T
        if np.linalg.matrix_rank(corners) < 3:
            continue  # degenerate, or edge-on
        shares = np.linalg.solve(corners.T, rays)
        with np.errstate(divide="ignore"):
            inverse = 1 / (depths[rows] @ shares) if orthographic else shares.sum(axis=0)
            hit = (shares >= 0).all(axis=0) & (inverse > 0) & (1 / inverse >= near)
        out[hit] = np.maximum(out[hit], inverse[hit])
    return out.reshape(height, width)
