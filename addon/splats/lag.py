"""Lag of splats: positions that Blender has rotated or scaled without shapes and colors.

Blender's Apply, and rotation of all points in Edit Mode, transform vertices, but not the attributes
`rotation`, `scale` and `radiance:sh_*`. The missing transform, the lag, follows from the mesh
alone: a custom property stores earlier positions of some of its splats. Undo, files and copies keep
that property, so no other state is needed. The lags of splats that Blender's Join adds are unknown.
"""

from typing import Any

import numpy as np

KEY = "gs_places"
"""Custom property of a mesh: positions of some splats, and the lag then."""
APPLIED = (
    "The positions of the splats of {} were rotated or scaled without their shapes and colors, as "
    "by Blender's Apply."
)
JOINED = (
    "Blender's Join added splats to {}. If their objects were rotated or scaled differently, their "
    "shapes and colors are wrong: undo it, and use Join under Edit Splats."
)
_MOST = 48
"""Number of stored positions; reading them takes 0.1 ms."""
_UNKNOWN = np.zeros((2, 3, 3))
"""Stored lags after Join; earlier versions stored one for each joined part."""
_ROUNDING = 1e-5
"""Relative tolerance of coordinates, far above float32 rounding."""
_FLAT = 1e-5
"""Smallest extent along an axis, as a share of the largest."""


def of(mesh: Any) -> np.ndarray | None:
    """[3, 3] float64, transform that the shapes of a mesh lack; None if Join made it unknown."""
    stored = mesh.get(KEY)
    if stored is None:
        return np.eye(3)
    lags = np.array(stored["lags"], np.float64)
    return lags.reshape(3, 3) if lags.size == 9 else None


def problem(mesh: Any) -> str:
    """Sentence about the lag of a mesh, with `{}` for the name of its object; empty without a lag.
    Fast enough for drawing a panel."""
    lag = of(mesh)
    if lag is None:
        return JOINED
    return "" if _is_none(lag) else APPLIED


def note(mesh: Any, lag: np.ndarray | None) -> None:
    """Store a lag of a mesh, None if unknown, with its current positions; its object is not in Edit
    Mode."""
    if not len(mesh.vertices):
        return
    mesh[KEY] = {
        "count": len(mesh.vertices),
        "places": _places(mesh).ravel().tolist(),
        "lags": (_UNKNOWN if lag is None else lag).ravel().tolist(),
    }


def forget(mesh: Any) -> None:
    """Remove the stored state, because the splats were replaced or corrected."""
    mesh.pop(KEY, None)


def is_miscounted(mesh: Any) -> bool:
    """True if a mesh has no stored state, or one with another number of splats."""
    stored = mesh.get(KEY)
    return stored is None or stored["count"] != len(mesh.vertices)


def follow(mesh: Any, *, edited: bool = False) -> bool:
    """Detect a transform of a mesh since the stored state, and update it; True if it changed.

    Args:
        mesh: A mesh of splats.
        edited: Splats can have been added in Edit Mode, where they are copies of others, instead of
            by Join.
    """
    if mesh.is_editmode or not len(mesh.vertices):  # not accessible
        return False
    now, stored, lag = _places(mesh), mesh.get(KEY), of(mesh)
    if not np.isfinite(now).all():
        return False
    if stored is not None and stored["count"] < len(mesh.vertices) and not edited:
        lag = None
    elif stored is not None and stored["count"] == len(mesh.vertices):
        turn = turn_between(np.array(stored["places"], np.float64).reshape(-1, 3), now)
        if turn is not None and _is_none(turn):
            return False
        if turn is not None and lag is not None:  # else single points were moved
            lag = turn @ lag
    note(mesh, lag)
    return True


def turn_between(before: np.ndarray, now: np.ndarray) -> np.ndarray | None:
    """Linear part of the affine map from earlier to current points.

    A similarity is preferred, and a rotation to a reflection, so that coplanar points have a
    solution too.

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
    weights = 1 / errors[:, None]
    old, new = (p - np.average(p, axis=0, weights=errors**-2.0) for p in (before, now))
    if _meets(old, new, errors + _ROUNDING * np.linalg.norm(before, axis=1)):
        return np.eye(3)
    extents = np.linalg.svd(old * weights, compute_uv=False)
    if len(before) < 3 or extents[1] <= _FLAT * extents[0]:
        return None
    turns = [_similarity(old * weights, new * weights, mirrored) for mirrored in (False, True)]
    turns.append(np.linalg.lstsq(old * weights, new * weights, rcond=_FLAT)[0].T)
    return next((turn for turn in turns if _meets(old @ turn.T, new, errors)), None)


def even(turn: np.ndarray) -> np.ndarray | None:
    """[3, 3], the similarity next to a linear map, with its volume and reflection; None if it has
    no volume."""
    u, sides, v = np.linalg.svd(turn)
    return u @ v * np.cbrt(sides.prod()) if sides[2] > 1e-12 + _FLAT * sides[0] else None


def _is_none(lag: np.ndarray) -> bool:
    """True if a lag is the identity, up to rounding."""
    return bool(np.abs(lag - np.eye(3)).max() <= 1e-5)


def _places(mesh: Any) -> np.ndarray:
    """[K, 3] float64, positions of splats spread over a mesh; the same ones for equal counts."""
    count = len(mesh.vertices)
    rows = range(count)
    if count > _MOST:
        rows = [at * (count - 1) // (_MOST - 1) for at in range(_MOST)]
    return np.array([mesh.vertices[row].co[:] for row in rows], np.float64)


def _meets(old: np.ndarray, new: np.ndarray, errors: np.ndarray) -> bool:
    return bool((np.linalg.norm(old - new, axis=1) <= errors).all())


def _similarity(old: np.ndarray, new: np.ndarray, mirrored: bool) -> np.ndarray:
    """[3, 3], the least-squares similarity, with or without reflection (Umeyama 1991)."""
    u, sides, v = np.linalg.svd(new.T @ old)
    handed = np.linalg.det(u) * np.linalg.det(v) < 0
    signs = np.array([1, 1, -1.0 if handed != mirrored else 1.0])
    return (u * signs) @ v * ((sides * signs).sum() / (old**2).sum())
