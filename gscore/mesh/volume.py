"""Volume of truncated signed distances (Curless and Levoy 1996), allocated in blocks near surfaces
(Niessner et al. 2013)."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

SIDE = 8
"""Voxels along a block."""
VOXELS = SIDE**3
"""Voxels of a block."""
BLOCK_BYTES = VOXELS * 6 * 4 + 8 + 3 * 8
"""Memory of a block: distance, weight, colour and its weight; key and corner."""
TRUNCATION = 6.0
"""Largest stored distance, voxels: several times the noise of depths, less than thin parts."""
_BAND = 2.0
"""Distance from a surface within which blocks are allocated, voxels."""
_BITS = 21
_HALF = 1 << (_BITS - 1)
REACH = (_HALF - 2) * SIDE
"""Largest coordinate in a volume, voxels."""
_CHUNK = 48
"""Blocks fused at a time, so that their arrays stay in the cache of a core."""
_ALONG = 3.0
"""Largest distance along a ray at which a voxel belongs to the surface on it, truncations; at
grazing angles the plane of a pixel is near all of its ray."""


@dataclass(frozen=True, kw_only=True)
class SurfaceView:
    """The surface in a picture, one plane per pixel."""

    viewmat: np.ndarray
    """[4, 4] float64, world to camera, OpenCV axes."""
    K: np.ndarray
    """[3, 3] float64, px."""
    planes: np.ndarray
    """[H, W, 4] float32: unit normal n towards the camera, and n p of the surface point p; camera
    axes, world units."""
    depth: np.ndarray
    """[H, W] float32, z of the surface, world units; infinite where the ray meets none."""
    weight: np.ndarray
    """[H, W] float32, 0 where nothing is known."""
    rgb: np.ndarray
    """[H, W, 3] float32."""


def packed(blocks: np.ndarray) -> np.ndarray:
    """[N] int64, the keys of blocks [N, 3] int64; in the order of x, y and z."""
    x, y, z = (blocks + _HALF).T
    return (x << 2 * _BITS) | (y << _BITS) | z


def unpacked(keys: np.ndarray) -> np.ndarray:
    """[N, 3] int64, the blocks of keys [N]."""
    low = (1 << _BITS) - 1
    return np.stack([keys >> 2 * _BITS, (keys >> _BITS) & low, keys & low], axis=1) - _HALF


def blocks_near(points: np.ndarray, voxel: float) -> np.ndarray:
    """Sorted keys of the blocks near points [P, 3] float64 within `REACH`, world units."""
    cells = points / voxel
    low = np.floor((cells - _BAND) / SIDE).astype(np.int64)
    span = np.floor((cells + _BAND) / SIDE).astype(np.int64) - low
    keys = [
        np.unique(packed(low[(span >= step).all(axis=1)] + np.array(step)))
        for step in np.ndindex(2, 2, 2)
    ]
    return np.unique(np.concatenate(keys))


def of_double_voxels(keys: np.ndarray) -> np.ndarray:
    """Sorted keys of the blocks of twice the size that contain the blocks of `keys`."""
    return np.unique(packed(unpacked(keys) >> 1))


class Volume:
    """Signed distances, positive in front of surfaces, at the voxels of some blocks.

    Voxel (i, j, k) of block (a, b, c) is at ((a, b, c) SIDE + (i, j, k)) voxel.
    """

    def __init__(self, keys: np.ndarray, voxel: float) -> None:
        """Allocate blocks.

        Args:
            keys: [N] int64, sorted, as of `blocks_near`.
            voxel: Distance between voxels, world units.
        """
        self.keys, self.voxel = keys, voxel
        self.truncation = TRUNCATION * voxel
        self.distances = np.zeros((len(keys), VOXELS), np.float32)
        """Sums of weight times distance, truncations."""
        self.weights = np.zeros((len(keys), VOXELS), np.float32)
        """Sums of weights; 0: no camera sees the voxel."""
        self.colors = np.zeros((len(keys), VOXELS, 4), np.float32)
        """Sums of weight times RGB, and of these weights, which are 0 away from surfaces."""
        self._corners = unpacked(keys) * (SIDE * voxel)
        self._offsets = np.indices((SIDE, SIDE, SIDE)).reshape(3, -1).T * voxel

    def __len__(self) -> int:
        return len(self.keys)

    def fuse(self, view: SurfaceView, pool: Executor) -> None:
        """Add a view; the same bits for any number of threads in `pool`."""
        rows = self._in_picture(view)
        parts = [rows[at : at + _CHUNK] for at in range(0, len(rows), _CHUNK)]
        pixels = _Pixels(view)
        for _ in pool.map(lambda part: self._fuse(view, pixels, part), parts):
            pass

    def _in_picture(self, view: SurfaceView) -> np.ndarray:
        """Rows of the blocks whose bounding spheres touch the view's frustum."""
        half = self.voxel * (SIDE - 1) / 2
        radius = half * 3**0.5
        R, t = view.viewmat[:3, :3], view.viewmat[:3, 3]
        x, y, z = ((self._corners + half) @ R.T + t).T
        height, width = view.depth.shape
        (fx, _, cx), (_, fy, cy), _ = view.K
        inside = z > -radius
        for across, focal, center, size in ((x, fx, cx, width), (y, fy, cy, height)):
            for sign, edge in ((1, center), (-1, size - center)):
                outside = -sign * focal * across - edge * z
                inside &= outside < radius * np.hypot(focal, edge)
        return np.flatnonzero(inside)

    def _fuse(self, view: SurfaceView, pixels: "_Pixels", rows: np.ndarray) -> None:
        R, t = view.viewmat[:3, :3], view.viewmat[:3, 3]
        corners = (self._corners[rows] @ R.T + t).astype(np.float32)
        offsets = (self._offsets @ R.T).astype(np.float32)
        x, y, z = ((corners[:, i, None] + offsets[:, i]).ravel() for i in range(3))
        height, width = view.depth.shape
        (fx, _, cx), (_, fy, cy), _ = view.K.astype(np.float32)
        with np.errstate(all="ignore"):  # the camera's own plane
            u, v = x / z * fx + cx, y / z * fy + cy
            seen = np.flatnonzero((z > 0) & (u >= 0) & (u < width) & (v >= 0) & (v < height))
        pixel = v[seen].astype(np.int32) * width + u[seen].astype(np.int32)
        weight, plane = pixels.weight[pixel], pixels.planes[pixel]
        along = (pixels.depth[pixel] - z[seen]) / np.float32(self.truncation)
        distance = plane[:, 0] * x[seen] + plane[:, 1] * y[seen] + plane[:, 2] * z[seen]
        distance = (distance - plane[:, 3]) / np.float32(self.truncation)
        distance[along > _ALONG] = 1
        known = (weight > 0) & (distance > -1) & (along > -_ALONG)
        seen, pixel = seen[known], pixel[known]
        distance, weight = np.minimum(distance[known], 1), weight[known]
        # Less behind the surface, where that of a thin part's other side is (Oleynikova 2017).
        weight *= np.minimum((1 + distance) * np.float32(TRUNCATION / (TRUNCATION - 1)), 1)
        block, voxel = rows[seen // VOXELS], seen % VOXELS
        self.distances[block, voxel] += weight * distance
        self.weights[block, voxel] += weight
        near = np.flatnonzero(np.abs(distance) < 1)
        weight = weight[near] * (1 - np.abs(distance[near]))
        self.colors[block[near], voxel[near]] += weight[:, None] * pixels.rgb[pixel[near]]


class _Pixels:
    """Arrays of a view, a row per pixel; colours with a 1 behind them."""

    def __init__(self, view: SurfaceView) -> None:
        self.planes = np.ascontiguousarray(view.planes).reshape(-1, 4)
        self.depth, self.weight = view.depth.ravel(), view.weight.ravel()
        self.rgb = np.ones((len(self.depth), 4), np.float32)
        self.rgb[:, :3] = view.rgb.reshape(-1, 3)


def dense_part(volume: Volume, corner: Sequence[int] | np.ndarray, blocks: int) -> np.ndarray:
    """Voxels of a cube of blocks as one array.

    Args:
        volume: The volume.
        corner: [3], its first block.
        blocks: Blocks along it.

    Returns:
        [S, S, S, 6] float32, S = blocks * SIDE: distance sum, weight, colour sums and weight; 0 in
        blocks that are not allocated.
    """
    steps = np.indices((blocks,) * 3).reshape(3, -1).T
    wanted = packed(np.asarray(corner) + steps)
    rows = np.searchsorted(volume.keys, wanted)
    rows[rows == len(volume.keys)] = 0
    there = np.flatnonzero(volume.keys[rows] == wanted)
    rows = rows[there]
    dense = np.zeros((blocks**3, VOXELS, 6), np.float32)
    dense[there, :, 0] = volume.distances[rows]
    dense[there, :, 1] = volume.weights[rows]
    dense[there, :, 2:] = volume.colors[rows]
    dense = dense.reshape(*(blocks,) * 3, *(SIDE,) * 3, 6).transpose(0, 3, 1, 4, 2, 5, 6)
    return dense.reshape(*(blocks * SIDE,) * 3, 6)
