"""The size of a model in metres, by the places that GPS has written into EXIF."""

from itertools import combinations
from typing import Any

import numpy as np

from .watch import colmap

LEAST_PLACES = 5
"""Photos with a place that are needed."""
_LEAST_EXTENT = 15.0
"""Metres between the photos farthest apart from which on GPS, good to some metres, tells a size."""
_FAR = 0.5
"""Share of the largest distance from which on two photos are compared."""
_MOST_SPREAD = 0.25
"""Relative spread (median absolute deviation) of what pairs say up to which they agree."""


def metres_per_unit(model: Any, places: dict[int, np.ndarray]) -> float | None:
    """What a unit of a model is in metres; None where GPS does not tell.

    Args:
        model: pycolmap's Reconstruction.
        places: Latitude and longitude in degrees and height in metres, [3], by number of the image.

    Distances between pairs of photos are compared, not positions: where all lie on one line, no
    rotation could be fitted.
    """
    numbers = sorted(set(places) & set(model.reg_image_ids()))
    if len(numbers) < LEAST_PLACES:
        return None
    geodetic = np.array([places[number] for number in numbers], np.float64)
    there = colmap().GPSTransform().ellipsoid_to_enu(geodetic, *geodetic[0])
    centers = np.array([model.images[number].projection_center() for number in numbers])
    first, second = np.array(list(combinations(range(len(numbers)), 2))).T
    metres = np.linalg.norm(there[first] - there[second], axis=1)
    units = np.linalg.norm(centers[first] - centers[second], axis=1)
    far = (metres > _FAR * metres.max()) & (units > 0)
    if metres.max() < _LEAST_EXTENT or not far.any():
        return None
    ratios = metres[far] / units[far]
    scale = float(np.median(ratios))
    spread = float(np.median(np.abs(ratios - scale))) / scale
    return scale if spread <= _MOST_SPREAD else None


def to_metres(model: Any, places: dict[int, np.ndarray]) -> bool:
    """Scale pycolmap's Reconstruction so that its unit is a metre; whether GPS tells how."""
    scale = metres_per_unit(model, places)
    if scale is None:
        return False
    p = colmap()
    model.transform(p.Sim3d(scale, p.Rotation3d(), np.zeros(3)))
    return True
