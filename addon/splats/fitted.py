"""How a few points were turned, scaled or stretched between two looks at them; no bpy."""

import numpy as np

_ROUNDING = 1e-5
"""Of coordinates, relative: float32 and some steps of arithmetic stay far below it."""
_FLAT = 1e-5
"""Share of the largest extent below which there is none."""


def turn_between(before: np.ndarray, now: np.ndarray) -> np.ndarray | None:
    """The linear part of the map that took points to where they are.

    A similarity is preferred where one fits, a turn to a mirror, so that points of one plane have
    an answer too.

    Args:
        before: [K, 3] float64.
        now: [K, 3] float64, the same points.

    Returns:
        [3, 3] float64, the identity itself where points were only shifted; None where no linear map
        did it, or where the points lie on a line and do not tell.
    """
    sizes = np.linalg.norm(now, axis=1)
    # A place is as exact as the largest number that it was computed from.
    errors = _ROUNDING * (sizes + np.median(sizes) + 1e-30)
    weights = 1 / errors
    old, new = _centered(before, weights), _centered(now, weights)
    if _meets(old, new, errors + _ROUNDING * np.linalg.norm(before, axis=1)):
        return np.eye(3)
    u, extents, axes = np.linalg.svd(old * weights[:, None], full_matrices=False)
    rank = int((extents > _FLAT * extents.max(initial=0.0)).sum())
    if rank < 2 or len(before) < 3:
        return None
    for mirrored in (False, True):
        found = _similarity(old * weights[:, None], new * weights[:, None], mirrored)
        if _meets(old @ found.T, new, errors):
            return found
    images = (u[:, :rank] / extents[:rank]).T @ (new * weights[:, None])  # [rank, 3], of `axes`
    found = _with_normal(images, axes)
    return found if _meets(old @ found.T, new, errors) else None


def is_similarity(turn: np.ndarray) -> bool:
    """Whether a [3, 3] turns, scales and mirrors, and stretches nothing; 0 is none."""
    sides = np.linalg.svd(turn, compute_uv=False)
    return bool(sides[0] - sides[2] <= 1e-4 * sides[0] and sides[2] > 1e-12)


def _centered(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    return points - np.average(points, axis=0, weights=weights**2)


def _meets(old: np.ndarray, new: np.ndarray, errors: np.ndarray) -> bool:
    return bool((np.linalg.norm(old - new, axis=1) <= errors).all())


def _similarity(old: np.ndarray, new: np.ndarray, mirrored: bool) -> np.ndarray:
    """[3, 3]: the best one by least squares, with or without a mirror (Umeyama 1991)."""
    u, sides, v = np.linalg.svd(new.T @ old)
    handed = np.linalg.det(u) * np.linalg.det(v) < 0
    signs = np.array([1, 1, -1.0 if handed != mirrored else 1.0])
    return (u * signs) @ v * ((sides * signs).sum() / (old**2).sum())


def _with_normal(images: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """[3, 3] that takes the rows of `axes` to `images`, and the normal of a plane to a normal."""
    if len(images) == 2:
        normal = np.cross(images[0], images[1]) * np.linalg.det(axes)
        images = np.vstack([images, normal / (np.sqrt(np.linalg.norm(normal)) + 1e-30)])
    return images.T @ axes
