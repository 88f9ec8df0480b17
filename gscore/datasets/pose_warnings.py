"""Pose warnings: implausible positions of cameras and points."""

from collections.abc import Iterator

import numpy as np

from ..scene import Scene, distances
from ..text_format import count_words, number
from .capture import listing

_STRAY = 100.0
"""Reported distance from the middle of the cameras, as a multiple of the median."""
_OFF_AXIS = 10.0
"""Reported distance of the principal point from the image centre, in image sizes."""


def position_warnings(scene: Scene) -> Iterator[str]:
    """Sentences on cameras and points far outside all others, by which the whole is measured."""
    centers = scene.cameras.centers
    middle = np.median(centers, axis=0)
    far, times = _far(centers, middle)
    if len(far):
        names = listing([scene.cameras.names[i] for i in far])
        yield (
            f"{names}: {times:.0f} times farther from the other cameras than these from each "
            "other. Sizes and learning rates follow the farthest camera; leave such views out."
        )
    far, times = _far(scene.points.points, middle)
    if len(far) > 0.001 * len(scene.points):
        yield (
            f"{number(len(far))} of {count_words(len(scene.points), 'point')} lie more than "
            f"{_STRAY:.0f} times farther from the cameras than half of the points do."
        )


def _far(places: np.ndarray, middle: np.ndarray) -> tuple[np.ndarray, float]:
    """Indices of places beyond _STRAY median distances, and how many the farthest lies away."""
    distance = distances(places, middle)
    median = float(np.median(distance)) if len(distance) else 0.0
    if len(distance) < 4 or not median > 0:
        return np.zeros(0, np.intp), 0.0
    return np.flatnonzero(distance > _STRAY * median), float(distance.max()) / median


def axis_warnings(scene: Scene) -> Iterator[str]:
    """A sentence on cameras whose axis passes far outside their picture: shifted lenses never are
    so much."""
    cameras = scene.cameras
    sizes = np.stack([cameras.widths, cameras.heights], axis=1)
    off = np.abs(cameras.Ks[:, :2, 2] / sizes - 0.5).max(axis=1)
    wrong = np.flatnonzero(off > _OFF_AXIS)
    if len(wrong):
        names = listing([cameras.names[i] for i in wrong])
        yield (
            f"{names}: the principal point lies {off.max():.0f} times the picture's size from its "
            "middle; no lens does that. Check the intrinsics."
        )
