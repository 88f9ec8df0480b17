"""Initial points: random points for captures without points, and colours for black points."""

from collections.abc import Callable

import numpy as np

from ..scene import FARTHEST, Cameras, PointCloud
from ..text_format import count_text, number
from .dataset import map_threads

RANDOM_POINTS = 100_000
"""Random points for a capture without points, as in the 3DGS paper for synthetic scenes."""
GREY = 128
"""Colour of points that are visible in no photo, sRGB byte."""


def point_warnings(points: PointCloud, usable: np.ndarray) -> list[str]:
    """Warnings about points that are left out, missing or black.

    Args:
        points: Points of the capture.
        usable: [P] bool, `within_reach` of them.
    """
    if not usable.any():
        return [
            f"The capture has no {'usable ' if len(usable) else ''}points. Unless points can be "
            "computed from the photos, a training starts from random ones, which takes longer and "
            "gives floaters. For better results run COLMAP's triangulation, or put a PLY of points "
            "named points3D.ply next to the cameras."
        ]
    warnings = []
    if not usable.all():
        first = int(np.flatnonzero(~usable)[0])
        warnings.append(
            f"{count_text(int((~usable).sum()), 'point is', 'points are')} not finite or beyond "
            f"{FARTHEST:g}, the first of them number {first} at {points.points[first].tolist()}; "
            "left out."
        )
    if not points.colors[usable].any():
        warnings.append(
            f"All points are black ({number(int(usable.sum()))} of them; COLMAP was run without "
            "extracting colours); they are coloured from the photos."
        )
    return warnings


def random_points(cameras: Cameras, count: int, *, seed: int) -> PointCloud:
    """Grey points, uniform in the space in view of the cameras.

    For cameras around an object: a cube centred at the point nearest to all optical axes, with
    sides as long as the median distance to it. Otherwise (forward or outward): the cameras' view
    volumes, as deep as three times the spread of the cameras.

    Args:
        cameras: At least one.
        count: Number of points.
        seed: Seed of the random generator.

    Returns:
        [count] points, world units.
    """
    rng = np.random.default_rng(seed)
    centers = cameras.centers
    focus = _focus(cameras)
    if focus is not None:
        center, distance = focus
        points = center + 0.5 * distance * rng.uniform(-1, 1, (count, 3))
    else:
        spread = float(np.linalg.norm(centers - centers.mean(axis=0), axis=1).max())
        # The cube root fills a pyramid uniformly. A single camera gives no length: 1.
        depth = (3 * spread if spread > 0 else 1.0) * np.cbrt(rng.uniform(0, 1, (count, 1)))
        i = rng.integers(0, len(cameras), count)
        sizes = np.stack([cameras.widths[i], cameras.heights[i], np.ones(count)], axis=1)
        pixels = sizes * np.column_stack([rng.uniform(0, 1, (count, 2)), np.ones(count)])
        rays = np.einsum("pij,pj->pi", np.linalg.inv(cameras.Ks)[i], pixels)
        points = centers[i] + np.einsum("pji,pj->pi", cameras.viewmats[i, :3, :3], rays * depth)
    return PointCloud(points=points, colors=np.full((count, 3), GREY, np.uint8), made_up=True)


def colors_from_photos(
    points: np.ndarray,
    cameras: Cameras,
    observed: list[np.ndarray | None],
    load: Callable[[int], tuple[np.ndarray, np.ndarray | None]],
) -> np.ndarray:
    """Mean colour of points in the photos that observe them.

    Args:
        points: [P, 3] float64, world.
        cameras: Cameras of the photos.
        observed: Indices of the points observed by each camera; None: unknown. Points without a
            known observation are projected into every photo, ignoring occlusion.
        load: Returns photo [H, W, 3] uint8 and mask [H, W] uint8 or None; masked-out pixels are
            skipped.

    Returns:
        [P, 3] uint8; grey for points in no photo.
    """
    known = np.zeros(len(points), bool)
    for index in observed:
        if index is not None:
            known[index] = True
    unknown = np.flatnonzero(~known)

    def sample(i: int) -> tuple[np.ndarray, np.ndarray]:
        own = observed[i]
        index = unknown if own is None else np.concatenate([own, unknown])
        pixels, inside = _project(cameras, i, points[index])
        index, pixels = index[inside], pixels[inside].astype(np.int64)
        image, mask = load(i)
        if mask is not None:
            kept = mask[pixels[:, 1], pixels[:, 0]] > 127
            index, pixels = index[kept], pixels[kept]
        return index, image[pixels[:, 1], pixels[:, 0]]

    total, number = np.zeros((len(points), 3), np.int64), np.zeros(len(points), np.int64)
    for index, values in map_threads(sample, list(range(len(cameras)))):
        total[index] += values
        number[index] += 1
    mean = np.rint(total / np.maximum(number, 1)[:, None])
    return np.where(number[:, None] > 0, mean, GREY).astype(np.uint8)


def _project(cameras: Cameras, i: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixel positions [P, 2] of world points in camera i, and the mask [P] bool of those in its
    image."""
    in_camera = points @ cameras.viewmats[i, :3, :3].T + cameras.viewmats[i, :3, 3]
    depth = in_camera[:, 2]
    safe = np.where(depth > 0, depth, 1.0)
    pixels = (in_camera[:, :2] @ cameras.Ks[i, :2, :2].T) / safe[:, None] + cameras.Ks[i, :2, 2]
    size = np.array([cameras.widths[i], cameras.heights[i]])
    return pixels, (depth > 0) & (pixels >= 0).all(axis=1) & (pixels < size).all(axis=1)


def _focus(cameras: Cameras) -> tuple[np.ndarray, float] | None:
    """Point [3] nearest to all optical axes and its median distance; None if they do not meet."""
    centers, axes = cameras.centers, cameras.viewmats[:, 2, :3]
    # Least squares: the components of (x - centre) orthogonal to each axis sum to zero.
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    matrix = across.sum(axis=0)
    # The smallest eigenvalue vanishes when all axes are parallel and have no nearest point.
    if np.linalg.eigvalsh(matrix)[0] < 1e-3 * len(cameras):
        return None
    focus = np.linalg.solve(matrix, np.einsum("cij,cj->i", across, centers))
    depth = float(np.median(np.einsum("ci,ci->c", focus - centers, axes)))
    spread = float(np.linalg.norm(centers - centers.mean(axis=0), axis=1).max())
    return (focus, depth) if depth > 0.5 * spread else None
