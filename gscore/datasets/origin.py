"""Local origin for captures with coordinates too large for float32."""

import math
from dataclasses import replace

import numpy as np

from ..scene import (
    camera_centers,
    distances,
    moved_viewmats,
    offset_between,
    origin_words,
    within_reach,
)
from .capture import Capture, View

_TOLERANCE = 0.01
"""Pixels by which rounding to float32 may move a projected point."""
_GAIN = 4.0
"""Least factor by which a local origin must reduce that error; it cannot help a capture that is
itself large."""
_SAMPLED = 1000
"""Most views and points that are evaluated, evenly spaced."""
_ROUNDING = 2.0**-24
"""Relative rounding error of float32."""


def about_origin(capture: Capture, origin: np.ndarray | None = None) -> Capture:
    """The capture in coordinates relative to a local origin, subtracted in float64.

    Args:
        capture: The capture as in its files.
        origin: [3], the local origin in the capture's world; zeros: none; None: chosen by
            `choose_origin`.

    Returns:
        The capture, with `Capture.origin`; `capture` itself if nothing moves.
    """
    if origin is None:
        chosen = choose_origin(capture)
        if chosen is None:
            return capture
        origin = offset_between(capture.origin, None) + chosen
    shift = offset_between(origin, capture.origin)
    if not shift.any():
        return capture
    views = [replace(view, viewmat=moved_viewmats(view.viewmat, shift)) for view in capture.views]
    points = replace(capture.points, points=capture.points.points - shift)
    local = origin if origin.any() else None
    warnings = capture.warnings if local is None else (*capture.warnings, _warning(local))
    return replace(capture, views=views, points=points, origin=local, warnings=warnings)


def _warning(origin: np.ndarray) -> str:
    return (
        f"The capture is far from the origin of its coordinates, where float32 is too coarse: "
        f"splats and cameras are relative to the local origin {origin_words(origin)}, which "
        f"their files state."
    )


def choose_origin(capture: Capture) -> np.ndarray | None:
    """[3] float64, local origin amid the cameras, in the capture's coordinates; None if float32 is
    fine enough without.

    It is the median camera position, rounded to a power of ten no larger than the capture, so that
    it usually stays the same if some photos are left out.
    """
    step = max(1, len(capture.views) // _SAMPLED)
    if not capture.views:
        return None
    centers = camera_centers(np.stack([view.viewmat for view in capture.views]))
    if not within_reach(centers).all():
        return None
    middle = np.median(centers, axis=0)
    radius = _median(distances(centers, middle))
    if float(np.abs(middle).max()) <= radius:
        return None  # the usual case, decided without the points
    points = capture.points.points[:: max(1, len(capture.points) // _SAMPLED)]
    points = points[within_reach(points)]
    size = max(radius, _median(distances(points, middle)))
    if not size > 0:
        return None
    digits = -math.floor(math.log10(size))
    origin = np.array([round(value, digits) for value in middle.tolist()])
    views = list(zip(capture.views[::step], centers[::step], strict=True))
    before, after = (
        _median(np.array([_pixels(view, center, points, size, about) for view, center in views]))
        for about in (np.zeros(3), origin)
    )
    return origin if before > max(_TOLERANCE, _GAIN * after) else None


def _pixels(
    view: View, center: np.ndarray, points: np.ndarray, size: float, about: np.ndarray
) -> float:
    """Pixels by which a view's points move if coordinates relative to `about` [3] are rounded."""
    z = points @ view.viewmat[2, :3] + view.viewmat[2, 3]
    depth = _median(z[z > 0]) or size
    largest = float(np.abs(center - about).max()) + depth
    return float(view.camera.K[0, 0]) * largest * _ROUNDING / depth


def _median(values: np.ndarray) -> float:
    return float(np.median(values)) if len(values) else 0.0
