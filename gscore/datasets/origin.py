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
"""Pixels that rounding to float32 may move what a camera sees."""
_GAIN = 4.0
"""How many times smaller that has to become for a local origin to be worth it: coordinates that are
large because the capture is cannot be made small."""
_LOOKED_AT = 1000
"""Views and points, spread evenly, that are looked at."""
_ROUNDING = 2.0**-24
"""Of float32, relative."""


def about_origin(capture: Capture, origin: np.ndarray | None = None) -> Capture:
    """The capture in coordinates about a local origin, subtracted in float64.

    Args:
        capture: As its files state it.
        origin: [3] that origin, in the coordinates of the capture's world; zeros: none; None: it is
            chosen by `choose_origin`.

    Returns:
        The capture, with `Capture.origin`; itself where nothing has to move.
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
    place = origin if origin.any() else None
    told = () if place is None else (_words(place),)
    return replace(
        capture, views=views, points=points, origin=place, warnings=(*capture.warnings, *told)
    )


def _words(origin: np.ndarray) -> str:
    return (
        f"The capture lies far from the origin of its coordinates, where float32 numbers are "
        f"coarse: splats and cameras are about the local origin {origin_words(origin)}, which "
        f"their files state."
    )


def choose_origin(capture: Capture) -> np.ndarray | None:
    """[3] float64, a place amid the cameras, in the coordinates that these have; None where float32
    is fine enough for them.

    It is the median of the camera positions, rounded to a power of ten no larger than the capture,
    so that as a rule it stays the same where some photos are left out.
    """
    step = max(1, len(capture.views) // _LOOKED_AT)
    if not capture.views:
        return None
    centers = camera_centers(np.stack([view.viewmat for view in capture.views]))
    if not within_reach(centers).all():
        return None
    middle = np.median(centers, axis=0)
    radius = _median(distances(centers, middle))
    if float(np.abs(middle).max()) <= radius:
        return None  # the usual case, in which no points are looked at
    points = capture.points.points[:: max(1, len(capture.points) // _LOOKED_AT)]
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
    """How far what a view sees moves in its picture where coordinates about a place are rounded."""
    z = points @ view.viewmat[2, :3] + view.viewmat[2, 3]
    depth = _median(z[z > 0]) or size
    largest = float(np.abs(center - about).max()) + depth
    return float(view.camera.K[0, 0]) * largest * _ROUNDING / depth


def _median(values: np.ndarray) -> float:
    return float(np.median(values)) if len(values) else 0.0
