"""Pose warnings: implausible positions of cameras and points."""

from collections.abc import Iterator

import numpy as np

from ..scene import Scene, distances
from ..text_format import count_words, number
from .capture import listing

_STRAY = 100.0
"""Distance from the middle of the cameras from which it is reported, in medians."""
_OFF_AXIS = 10.0
"""Distance of the principal point from the image centre from which it is reported, in image
sizes."""


def position_warnings(scene: Scene) -> Iterator[str]:
    """Warnings about cameras and points far from all others, which distort the scene's size."""
    centers = scene.cameras.centers
    middle = np.median(centers, axis=0)
    far, times = _far(centers, middle)
    if len(far):
        names = listing([scene.cameras.names[i] for i in far])
        yield (
            f"{names}: {times:.0f} times farther from the other cameras than these from each "
            "other. Sizes and learning rates depend on the farthest camera; leave such views out."
        )
    far, times = _far(scene.points.points, middle)
    if len(far) > 0.001 * len(scene.points):
        yield (
            f"{number(len(far))} of {count_words(len(scene.points), 'point')} are more than "
            f"{_STRAY:.0f} times farther from the cameras than half of the points."
        )


def _far(positions: np.ndarray, middle: np.ndarray) -> tuple[np.ndarray, float]:
    """Indices of positions [N, 3] beyond _STRAY median distances from `middle`, and the largest
    distance in medians."""
    distance = distances(positions, middle)
    median = float(np.median(distance)) if len(distance) else 0.0
    if len(distance) < 4 or not median > 0:
        return np.zeros(0, np.intp), 0.0
    return np.flatnonzero(distance > _STRAY * median), float(distance.max()) / median


def axis_warnings(scene: Scene) -> Iterator[str]:
    """Warning about cameras whose optical axis passes far outside their picture, farther than any
    shifted lens."""
    cameras = scene.cameras
    sizes = np.stack([cameras.widths, cameras.heights], axis=1)
    off = np.abs(cameras.Ks[:, :2, 2] / sizes - 0.5).max(axis=1)
    wrong = np.flatnonzero(off > _OFF_AXIS)
    if len(wrong):
        names = listing([cameras.names[i] for i in wrong])
        yield (
            f"{names}: the principal point is {off.max():.0f} times the picture's size from its "
            "middle; no lens does that. Check the intrinsics."
        )
