"""Texture of a mesh: an atlas of its triangles by xatlas, filled with the colours of photos."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from ..extras import need
from ..raster.mesh import mesh_depth
from ..scene import Cameras
from .clean import vertex_normals
from .surface_mesh import SurfaceMesh

Photo = tuple[np.ndarray, np.ndarray | None]
"""[H, W, 3] float32 colours and [H, W] uint8 mask, 255 = keep, or None; at a camera's size."""
_SHARP = 6.0
"""Exponent of a photo's pixels per surface area in its weight: the sharpest photos decide, and the
seams between them stay soft."""
_BEHIND = 2.0
"""Depth behind the nearest triangle up to which a texel is seen, voxels."""
_GUTTER = 8
"""Texels around the atlas's parts that are filled too, for filters of textures."""


def textured(
    mesh: SurfaceMesh,
    cameras: Cameras,
    photos: Callable[[int], Photo],
    size: int,
    voxel: float,
    steps: Callable[[Sequence[int]], Iterator[int]],
) -> SurfaceMesh:
    """The mesh with an atlas and a texture; vertices at its seams occur more than once.

    Args:
        mesh: The mesh; its colours fill what no photo shows.
        cameras: Cameras of the photos, in its world.
        photos: Returns the photo of a camera.
        size: Side of the texture, px.
        voxel: Accuracy of the mesh, world units.
        steps: Yields the indices of cameras, with progress.

    Raises:
        BackendError: xatlas is missing.
    """
    parametrize = need("xatlas", "A texture").parametrize
    middle = mesh.vertices.mean(axis=0)
    rows, faces, uvs = parametrize(
        (mesh.vertices - middle).astype(np.float32), mesh.triangles.astype(np.uint32)
    )
    faces = faces.astype(np.int64)
    normals = vertex_normals(mesh.vertices, mesh.triangles)[rows]
    mesh = replace(
        mesh, vertices=mesh.vertices[rows], triangles=faces, colors=mesh.colors[rows], uvs=uvs
    )
    values = np.concatenate([mesh.vertices - middle, normals, mesh.colors], axis=1)
    covered, texels = _at_texels(uvs, faces, values, size)
    points, directions, plain = texels[:, :3] + middle, texels[:, 3:6], texels[:, 6:]
    sums, weights = np.zeros((len(points), 3)), np.zeros(len(points))
    for index in steps(range(len(cameras))):
        seen, weight, rgb = _seen(mesh, cameras, index, photos(index), points, directions, voxel)
        sums[seen] += weight[:, None] * rgb
        weights[seen] += weight
    weights = weights[:, None]
    colors = np.divide(sums, weights, out=plain.copy(), where=weights > 0)
    texture = np.zeros((size, size, 3), np.uint8)
    texture[covered] = np.rint(np.clip(colors, 0, 1) * 255)
    return replace(mesh, texture=_with_gutter(texture, covered))


def _at_texels(
    uvs: np.ndarray, faces: np.ndarray, values: np.ndarray, size: int
) -> tuple[np.ndarray, np.ndarray]:
    """Mask [S, S] of the texels in triangles, and values [M, k] there, from those of vertices
    [V, k]: each column is drawn as the depth of the atlas."""
    low, high = values.min(axis=0), values.max(axis=0)
    span = np.maximum(high - low, 1e-12)
    columns: list[np.ndarray] = []
    covered = np.zeros((size, size), bool)
    for column in ((values - low) / span).T:
        places = np.concatenate([uvs * size, 1 + column[:, None]], axis=1)
        inverse = mesh_depth(
            places, faces.astype(np.int32), np.eye(3), np.eye(4), size, size, orthographic=True
        )
        covered = inverse > 0
        columns.append(1 / inverse[covered].astype(np.float64) - 1)
    return covered, np.stack(columns, axis=1) * span + low


def _seen(
    mesh: SurfaceMesh,
    cameras: Cameras,
    index: int,
    photo: Photo,
    points: np.ndarray,
    normals: np.ndarray,
    voxel: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rows of the points that a photo shows, their weights and colours."""
    from scipy.ndimage import map_coordinates

    K, viewmat = cameras.Ks[index], cameras.viewmats[index]
    width, height = int(cameras.widths[index]), int(cameras.heights[index])
    places = points @ viewmat[:3, :3].T + viewmat[:3, 3]
    towards = -((normals @ viewmat[:3, :3].T) * places).sum(axis=1)
    with np.errstate(all="ignore"):  # the camera's own plane
        u = places[:, 0] / places[:, 2] * K[0, 0] + K[0, 2]
        v = places[:, 1] / places[:, 2] * K[1, 1] + K[1, 2]
        inside = (places[:, 2] > 0) & (towards > 0)
        inside &= (u >= 1) & (u < width - 1) & (v >= 1) & (v < height - 1)
    rows = np.flatnonzero(inside)
    u, v, z = u[rows], v[rows], places[rows, 2]
    pixel = v.astype(int), u.astype(int)
    faces = mesh.triangles.astype(np.int32)
    nearest = mesh_depth(mesh.vertices, faces, K, viewmat, width, height)[pixel]
    rgb, mask = photo
    shown = z * nearest < 1 + _BEHIND * voxel * nearest
    if mask is not None:
        shown &= mask[pixel] >= 128
    rows, u, v, z = rows[shown], u[shown], v[shown], z[shown]
    distance = np.linalg.norm(places[rows], axis=1)
    # Pixels per area grow with the cosine, and fall with the square of the distance.
    weight = (towards[rows] / distance * (voxel / distance) ** 2 * K[0, 0] ** 2) ** _SHARP
    at = np.stack([v - 0.5, u - 0.5])
    colors = [map_coordinates(rgb[..., i], at, order=1, mode="nearest") for i in range(3)]
    return rows, weight, np.stack(colors, axis=1)


def _with_gutter(texture: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """The texture with texels near covered ones filled by the nearest of these."""
    from scipy.ndimage import distance_transform_edt

    distance, nearest = np.zeros(covered.shape), np.zeros((2, *covered.shape), np.int32)
    distance_transform_edt(~covered, return_indices=True, distances=distance, indices=nearest)
    filled = texture[nearest[0], nearest[1]]
    filled[distance > _GUTTER] = 0
    return filled
