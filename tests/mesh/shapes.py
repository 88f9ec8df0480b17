"""Splats on shapes whose surfaces are known, and cameras around them."""

import numpy as np

from gscore.scene import Cameras
from gscore.sh import rgb_to_sh0
from gscore.splats import Splats
from gscore.transforms import rotmat_to_quat

RADIUS = 1.0
HALF = np.array([0.6, 0.4, 0.5])
"""Half sides of the box."""


def flat_splats(points: np.ndarray, normals: np.ndarray, size: float, rgb: np.ndarray) -> Splats:
    """Opaque discs at points [N, 3] with unit normals [N, 3]; `size`: standard deviation."""
    helper = np.where(np.abs(normals[:, :1]) < 0.9, [[1.0, 0, 0]], [[0, 1.0, 0]])
    first = np.cross(normals, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    frames = np.stack([first, np.cross(normals, first), normals], axis=2)
    count = len(points)
    return Splats(
        means=points.astype(np.float32),
        quats=rotmat_to_quat(frames).astype(np.float32),
        scales=np.tile(np.log([size, size, size / 20]), (count, 1)).astype(np.float32),
        opacities=np.full(count, 5, np.float32),
        sh0=rgb_to_sh0(rgb)[:, None].astype(np.float32),
        shN=np.zeros((count, 0, 3), np.float32),
    )


def sphere(count: int = 6000) -> Splats:
    """A sphere of `RADIUS`, red where x is above 0, else green."""
    step = np.arange(count) + 0.5
    polar, turn = np.arccos(1 - 2 * step / count), np.pi * (1 + 5**0.5) * step
    normals = np.stack(
        [np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], axis=1
    )
    red = normals[:, 0] > 0
    rgb = np.where(red[:, None], [0.9, 0.1, 0.1], [0.1, 0.8, 0.1])
    return flat_splats(normals * RADIUS, normals, 1.6 * RADIUS / count**0.5, rgb)


def box(per_side: int = 40) -> Splats:
    """A box of half sides `HALF`."""
    grid = (np.indices((per_side, per_side)).reshape(2, -1).T + 0.5) / per_side * 2 - 1
    points, normals = [], []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            place = np.insert(grid, axis, sign, axis=1)
            points.append(place * HALF)
            normals.append(np.tile(sign * np.eye(3)[axis], (len(grid), 1)))
    places = np.concatenate(points)
    return flat_splats(places, np.concatenate(normals), 0.45 / per_side, np.full_like(places, 0.5))


def around(
    count: int = 30, *, size: int = 120, distance: float = 3.5, least: float = -1
) -> Cameras:
    """Cameras on a sphere around the origin, facing it; `least`: the lowest sine of elevation."""
    step = np.arange(count) + 0.5
    height = 1 - (1 - least) * step / count
    turn = np.pi * (1 + 5**0.5) * step
    out = np.sqrt(1 - height**2)
    eyes = distance * np.stack([out * np.cos(turn), out * np.sin(turn), height], axis=1)
    viewmats = np.tile(np.eye(4), (count, 1, 1))
    for viewmat, eye in zip(viewmats, eyes, strict=True):
        forward = -eye / np.linalg.norm(eye)
        right = np.cross(forward, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        viewmat[:3, :3] = np.stack([right, np.cross(forward, right), forward])
        viewmat[:3, 3] = -viewmat[:3, :3] @ eye
    K = np.array([[1.35 * size, 0, size / 2], [0, 1.35 * size, size / 2], [0, 0, 1]])
    return Cameras(
        viewmats=viewmats,
        Ks=np.tile(K, (count, 1, 1)),
        widths=np.full(count, size, np.int64),
        heights=np.full(count, size, np.int64),
        names=tuple(f"view_{i:03d}.png" for i in range(count)),
    )


def from_box(points: np.ndarray) -> np.ndarray:
    """[N], distance of points [N, 3] from the surface of the box."""
    beyond = np.abs(points) - HALF
    outside = np.linalg.norm(np.maximum(beyond, 0), axis=1)
    return np.abs(outside + np.minimum(beyond.max(axis=1), 0))
