"""Linear map between two states of some points: rotation, scale or stretch; no bpy."""

import numpy as np

_ROUNDING = 1e-5
"""Relative tolerance of coordinates, far above float32 rounding."""
_FLAT = 1e-5
"""Smallest extent along an axis, as a share of the largest."""


def turn_between(before: np.ndarray, now: np.ndarray) -> np.ndarray | None:
    """Linear part of the affine map from earlier to current points.

    A fitting similarity is preferred, and a rotation to a reflection, so that coplanar points have
    a solution too.

    Args:
        before: [K, 3] float64.
        now: [K, 3] float64, the same points.

    Returns:
        [3, 3] float64, exactly the identity for a translation; None if no linear map fits, or the
        points are collinear.
    """
    sizes = np.linalg.norm(now, axis=1)
    # The precision of a coordinate is that of the largest number in its computation.
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
        turn = _similarity(old * weights[:, None], new * weights[:, None], mirrored)
        if _meets(old @ turn.T, new, errors):
            return turn
    images = (u[:, :rank] / extents[:rank]).T @ (new * weights[:, None])  # [rank, 3], of `axes`
    turn = _with_normal(images, axes)
    return turn if _meets(old @ turn.T, new, errors) else None


def is_similarity(turn: np.ndarray) -> bool:
    """True if a [3, 3] matrix is a non-zero similarity, with or without reflection."""
    sides = np.linalg.svd(turn, compute_uv=False)
    return bool(sides[0] - sides[2] <= 1e-4 * sides[0] and sides[2] > 1e-12)


def _centered(points: np.ndarray, weights: np.ndarray) -> np.ndarray:
    return points - np.average(points, axis=0, weights=weights**2)


def _meets(old: np.ndarray, new: np.ndarray, errors: np.ndarray) -> bool:
    return bool((np.linalg.norm(old - new, axis=1) <= errors).all())


def _similarity(old: np.ndarray, new: np.ndarray, mirrored: bool) -> np.ndarray:
    """[3, 3], the least-squares similarity, with or without reflection (Umeyama 1991)."""
    u, sides, v = np.linalg.svd(new.T @ old)
    handed = np.linalg.det(u) * np.linalg.det(v) < 0
    signs = np.array([1, 1, -1.0 if handed != mirrored else 1.0])
    return (u * signs) @ v * ((sides * signs).sum() / (old**2).sum())


def _with_normal(images: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """[3, 3] that maps the rows of `axes` to `images`, and the normal of a plane to a normal."""
    if len(images) == 2:
        normal = np.cross(images[0], images[1]) * np.linalg.det(axes)
        images = np.vstack([images, normal / (np.sqrt(np.linalg.norm(normal)) + 1e-30)])
    return images.T @ axes
