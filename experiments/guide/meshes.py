"""Meshes as an artist would bring them: a scan of all there is, and walls and floors as planes."""

from pathlib import Path

import numpy as np

from experiments.depth.captures import Source, exact
from gscore.io.colmap.folder import read_model
from gscore.io.mesh.files import write_mesh
from gscore.io.ply.splats import read_ply
from gscore.raster.api import render

Mesh = tuple[np.ndarray, np.ndarray]
"""Vertices [V, 3] and triangles [T, 3]."""
_SIDE, _STEP, _JUMP = 480, 4, 0.04
"""Pixels across a photo, pixels between two corners of a scan, and the largest relative difference
of the inverse depths in one of its triangles."""
_PLANES, _TRIALS, _BEHIND, _LEAST = 3, 1500, 0.02, 0.03
"""Walls and floors that are looked for, planes tried for each, share of the scan that may lie
behind one, and that must lie on it."""


def scan_of(source: Source, splats: Path | None) -> Mesh:
    """All surfaces that training photos show: by exact depth, or as a training on all of them has
    them."""
    vertices: list[np.ndarray] = []
    triangles: list[np.ndarray] = []
    total, model = 0, read_model(source.folder)
    known = None if splats is None else read_ply(splats)
    for image in model.images:
        if image.name in source.test:
            continue
        camera = model.cameras[image.camera_id]
        factor = _SIDE / camera.width
        width, height = _SIDE, round(camera.height * factor)
        K = np.diag([factor, height / camera.height, 1]) @ camera.K
        if known is None:
            stored = exact(source, image.name)
            rows = ((np.arange(height) + 0.5) * stored.shape[0] / height).astype(int)
            columns = ((np.arange(width) + 0.5) * stored.shape[1] / width).astype(int)
            inverse = stored[np.ix_(rows, columns)]
        else:
            depth = np.asarray(render(known, K, image.viewmat, width, height).median_depth)
            inverse = np.where(depth > 0, 1 / np.where(depth > 0, depth, 1), 0)
        places, own = _triangulated(inverse, K, image.viewmat)
        vertices.append(places)
        triangles.append(own + total)
        total += len(places)
    return np.concatenate(vertices), np.concatenate(triangles)


def _triangulated(inverse: np.ndarray, K: np.ndarray, viewmat: np.ndarray) -> Mesh:
    """The surface of a depth map, cut where depths jump."""
    v, u = np.mgrid[0 : inverse.shape[0] : _STEP, 0 : inverse.shape[1] : _STEP]
    value = inverse[v, u]
    z = 1 / np.where(value > 0, value, 1)
    rays = np.stack([u + 0.5, v + 0.5, np.ones_like(z)], axis=-1) @ np.linalg.inv(K).T
    places = (rays * z[..., None] - viewmat[:3, 3]) @ viewmat[:3, :3]
    at = np.arange(z.size).reshape(z.shape)
    quads = np.stack([at[:-1, :-1], at[:-1, 1:], at[1:, :-1], at[1:, 1:]], -1).reshape(-1, 4)
    own = value.ravel()[quads]
    good = (own.min(axis=1) > 0) & (own.max(axis=1) < (1 + _JUMP) * own.min(axis=1))
    quads = quads[good]
    return places.reshape(-1, 3), np.concatenate([quads[:, [0, 1, 2]], quads[:, [2, 1, 3]]])


def walls_of(scan: Mesh, centers: np.ndarray) -> Mesh:
    """The largest planes of a scan behind which next to nothing lies, each as one rectangle."""
    rng = np.random.default_rng(0)
    points = scan[0][np.unique(scan[1])]
    points = points[rng.permutation(len(points))[:6000]]
    middle = np.median(points, axis=0)
    reach = np.linalg.norm(points - middle, axis=1)
    points = points[reach < 3 * np.median(reach)]
    tolerance, left = 0.015 * np.median(reach), points
    vertices, triangles = [], []
    while len(vertices) < _PLANES and len(left) > 2:
        a, b, c = left[rng.integers(0, len(left), (3, _TRIALS))]
        normals = np.cross(b - a, c - a)
        normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-12)[:, None]
        heights = (normals * a).sum(axis=1)
        side = np.sign(np.median(centers @ normals.T - heights, axis=0))
        normals, heights = normals * side[:, None], heights * side
        above = points @ normals.T - heights
        fair = (above < -2 * tolerance).mean(axis=0) < _BEHIND
        count = np.where(fair, (np.abs(left @ normals.T - heights) < tolerance).sum(axis=0), 0)
        best = int(count.argmax())
        if count[best] < _LEAST * len(points):
            break
        off = np.abs(left @ normals[best] - heights[best])
        own, left = left[off < tolerance], left[off >= 3 * tolerance]
        center = own.mean(axis=0)
        axes = np.linalg.svd(own - center, full_matrices=False)[2]
        flat = (own - center) @ axes[:2].T
        low, high = np.quantile(flat, 0.01, axis=0), np.quantile(flat, 0.99, axis=0)
        corners = [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]
        vertices.append(center + np.array(corners) @ axes[:2])
        triangles.append(np.array([[0, 1, 2], [0, 2, 3]]) + 4 * len(triangles))
    return np.concatenate(vertices), np.concatenate(triangles)


def write_scaled(path: Path, mesh: Mesh, factor: float, about: np.ndarray) -> None:
    """A mesh made larger about a place, as one of a wrong scale is."""
    write_mesh(path, about + factor * (mesh[0] - about), mesh[1])
