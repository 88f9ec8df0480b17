"""Marching cubes on a volume (Lewiner et al. 2003, by scikit-image), part by part."""

from collections.abc import Callable

import numpy as np

from ..extras import need
from .volume import SIDE, Volume, dense_part, unpacked

PURPOSE = "A mesh"
_GROUP = 8
"""Blocks along a part of the volume that is contoured at once."""


def contour(
    volume: Volume, on_part: Callable[[int, int], None] = lambda done, total: None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The surface where distances change their sign, open where no camera looked.

    A cube of eight voxels has triangles if all of them were seen. Neighbouring parts share a layer
    of voxels, and with it the vertices on it to the bit.

    Args:
        volume: Fused views.
        on_part: Called with the number of contoured parts and of all parts.

    Returns:
        Vertices [V, 3] float64, world units; triangles [T, 3] int64, counter-clockwise from
        outside; colours [V, 3] float32.

    Raises:
        BackendError: scikit-image is missing.
    """
    groups = np.unique(np.floor_divide(unpacked(volume.keys), _GROUP), axis=0)
    points, triangles, colors = [np.zeros((0, 3))], [np.zeros((0, 3), np.int64)], []
    count = 0
    for done, group in enumerate(groups):
        vertices, faces, rgb = _contour_part(volume, group * _GROUP)
        points.append(vertices + group * (_GROUP * SIDE))
        triangles.append(faces + count)
        colors.append(rgb)
        count += len(vertices)
        on_part(done + 1, len(groups))
    vertices, first, rows = np.unique(
        np.concatenate(points), axis=0, return_index=True, return_inverse=True
    )
    faces = rows.ravel()[np.concatenate(triangles)]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    rgb = np.concatenate([np.zeros((0, 3), np.float32), *colors])[first]
    return vertices * volume.voxel, faces, rgb


def _contour_part(volume: Volume, corner: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, voxels from `corner`, triangles and colours of a part."""
    size = _GROUP * SIDE + 1
    dense = dense_part(volume, corner, _GROUP + 1)[:size, :size, :size]
    known = dense[..., 1] > 0
    field = np.ones(known.shape, np.float32)
    np.divide(dense[..., 0], dense[..., 1], out=field, where=known)
    cubes = known.copy()  # by their last voxels, as scikit-image has them
    for axis in range(3):
        along = np.moveaxis(cubes, axis, 0)
        along[1:] &= along[:-1].copy()
        along[0] = False
    inside = field[known] < 0
    if not cubes.any() or inside.all() or not inside.any():
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64), np.zeros((0, 3), np.float32)
    marching_cubes = need("skimage.measure", PURPOSE).marching_cubes
    from scipy.ndimage import map_coordinates  # scikit-image needs it too

    try:
        vertices, faces, _, _ = marching_cubes(field, 0.0, mask=cubes, allow_degenerate=True)
    except RuntimeError:  # no cube with a change of sign was seen
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64), np.zeros((0, 3), np.float32)
    rgb = np.stack(
        [map_coordinates(dense[..., i], vertices.T, order=1) for i in range(2, 6)], axis=1
    )
    rgb = rgb[:, :3] / np.maximum(rgb[:, 3:], 1e-12)
    return vertices.astype(np.float64), faces.astype(np.int64), np.clip(rgb, 0, 1)
