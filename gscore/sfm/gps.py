"""Size in metres and up of a model, by the places that GPS has written into EXIF."""

import math
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from . import database
from .watch import colmap

LEAST_PLACES = 5
"""Photos with a place that are needed."""
_LEAST_EXTENT = 15.0
"""Metres between the photos farthest apart from which on GPS, good to some metres, tells a size."""
_FAR = 0.5
"""Share of the largest distance from which on two photos are compared."""
_MOST_SPREAD = 0.25
"""Relative spread (median absolute deviation) of what pairs say up to which they agree."""
_MOST_TILT = 4.0
"""Degrees by which up may be off, a standard deviation, to be taken from GPS: a hand that holds a
camera level is off by as much."""
_INDEPENDENT = 10
"""Places whose errors count as independent, at most: those of GPS stay alike for minutes."""
_STRAY = 2.5
"""Typical errors from which on a place counts less."""
_EXACT = 1e-6
"""Metres by which a place is off at least."""
_ANY_TURN = math.pi**2 / 3
"""Variance of an angle of which nothing is known."""
_ROUNDS = 20
"""Fits with weights by the errors of the one before."""


@dataclass(frozen=True)
class Gps:
    """What GPS tells of a model's world."""

    metres: float | None = None
    """That a unit of the model is; None: GPS does not tell."""
    up: np.ndarray | None = None
    """[3] float64, unit, in the model's world; None: GPS does not tell."""
    tilt: float = math.nan
    """Degrees by which that up may be off, a standard deviation; told where `metres` are."""


def read_gps(model: Any, places: dict[int, np.ndarray]) -> Gps:
    """What the places of photos tell of a model's world.

    Args:
        model: pycolmap's Reconstruction.
        places: Latitude and longitude in degrees and height in metres, [3], by number of the image.
    """
    numbers = sorted(set(places) & set(model.reg_image_ids()))
    if len(numbers) < LEAST_PLACES:
        return Gps()
    geodetic = np.array([places[number] for number in numbers], np.float64)
    there = colmap().GPSTransform().ellipsoid_to_enu(geodetic, *geodetic[0])
    centers = np.array([model.images[number].projection_center() for number in numbers])
    metres = _metres_per_unit(centers, there)
    if metres is None:
        return Gps()
    up, tilt = _up(centers, there)
    return Gps(metres, up if tilt <= _MOST_TILT else None, tilt)


def places_in_metres(file: Path) -> dict[str, np.ndarray]:
    """Where the photos of a database were taken, [3] float64 to the east, to the north and up of
    the first in metres, by alias; only those of which EXIF tells it."""
    places = database.gps_places(file)
    if not places:
        return {}
    names, geodetic = database.aliases(file), np.array(list(places.values()))
    there = colmap().GPSTransform().ellipsoid_to_enu(geodetic, *geodetic[0])
    return dict(zip((names[number] for number in places), there, strict=True))


def to_metres(model: Any, gps: Gps) -> None:
    """Scale pycolmap's Reconstruction so that its unit is a metre, where GPS tells how."""
    if gps.metres is not None:
        p = colmap()
        model.transform(p.Sim3d(gps.metres, p.Rotation3d(), np.zeros(3)))


def _metres_per_unit(centers: np.ndarray, there: np.ndarray) -> float | None:
    """What a unit is in metres, of places [n, 3] in both; None where they do not agree on it.

    Distances between pairs of photos are compared, not positions: where all lie on one line, no
    rotation could be fitted.
    """
    first, second = np.array(list(combinations(range(len(centers)), 2))).T
    metres = np.linalg.norm(there[first] - there[second], axis=1)
    units = np.linalg.norm(centers[first] - centers[second], axis=1)
    far = (metres > _FAR * metres.max()) & (units > 0)
    if metres.max() < _LEAST_EXTENT or not far.any():
        return None
    ratios = metres[far] / units[far]
    scale = float(np.median(ratios))
    spread = float(np.median(np.abs(ratios - scale))) / scale
    return scale if spread <= _MOST_SPREAD else None


def _up(centers: np.ndarray, there: np.ndarray) -> tuple[np.ndarray, float]:
    """Up in the world of `centers`, and the degrees by which it may be off.

    Args:
        centers: [n, 3], world.
        there: [n, 3], the same places in metres to the east, to the north and up.
    """
    weights = np.ones(len(centers))
    for _ in range(_ROUNDS):
        rotation, placed, errors = _fit(centers, there, weights)
        sizes = np.linalg.norm(errors, axis=1)
        usual = max(float(np.median(sizes)), _EXACT)
        weights = np.minimum(1.0, _STRAY * usual / np.maximum(sizes, _EXACT))
    return rotation[2], _tilt(placed, errors, weights)


def _fit(
    centers: np.ndarray, there: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The similarity from the world to metres (Umeyama 1991): its rotation [3, 3], the places it
    leads to about their middle [n, 3], and how far GPS is off from these [n, 3]."""
    total = weights.sum()
    a = centers - weights @ centers / total
    b = there - weights @ there / total
    u, s, vt = np.linalg.svd((b * weights[:, None]).T @ a)
    flip = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = u * flip @ vt
    placed = a @ rotation.T * ((s * flip).sum() / (weights @ (a**2).sum(axis=1)))
    return rotation, placed, b - placed


def _tilt(placed: np.ndarray, errors: np.ndarray, weights: np.ndarray) -> float:
    """Degrees, a standard deviation, by which a fitted rotation may lean.

    The variance of a small turn about one of the places' main axes is the errors' variance over
    their inertia about it. About a line on which all lie nothing is known, and the turn may be any.
    Heights of GPS are worse than the rest, so theirs count where they are larger.
    """
    count = len(placed)
    overall = weights @ (errors**2).sum(axis=1) / max(3 * count - 7, 1)
    heights = weights @ errors[:, 2] ** 2 / max(count - 3, 1)
    variance = max(overall, heights) * count / min(count, _INDEPENDENT)
    outer = np.einsum("n,ni,nj->ij", weights, placed, placed)
    inertia, axes = np.linalg.eigh(np.trace(outer) * np.eye(3) - outer)
    turns = np.minimum(variance / np.maximum(inertia, _EXACT**2), _ANY_TURN)
    covariance = axes * turns @ axes.T
    leaning = float(np.linalg.eigvalsh(covariance[:2, :2])[-1])  # about the axes that are level
    return math.degrees(math.sqrt(leaning))
