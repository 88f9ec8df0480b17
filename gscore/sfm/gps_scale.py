"""GPS scale and up direction of an SfM model, from the positions in EXIF."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from . import database
from .pycolmap_thread import colmap

LEAST_PLACES = 5
"""Minimum number of photos with a GPS position."""
_LEAST_EXTENT = 15.0
"""Metres across all photos from which on GPS, good to some metres, tells a size."""
_MOST_SCALE_ERROR = 0.15
"""Relative standard deviation of the size up to which it is taken from GPS."""
_MOST_TILT = 4.0
"""Degrees by which up may be off, a standard deviation, to be taken from GPS: a hand that holds a
camera level is off by as much."""
_INDEPENDENT = 10
"""Places whose errors count as independent, at most: those of GPS stay alike for minutes."""
_LESS = 2.5
"""Typical errors from which on a place counts less."""
_STRAY, _STRAY_METRES = 6.0, 10.0
"""Typical errors, and metres, beyond both of which a place is stray and does not count."""
_TRIPLES = 500
"""Fits to three photos to begin with: with every second place stray, 60 of them have none."""
_EXACT = 1e-6
"""Metres by which a place is off at least."""
_ANY_TURN = math.pi**2 / 3
"""Variance of a uniformly distributed angle."""
_ROUNDS = 20
"""Fits with weights by the errors of the one before."""


@dataclass(frozen=True)
class Gps:
    """Scale and up direction of a model by GPS."""

    metres: float | None = None
    """Metres per unit of the model; None: unknown."""
    up: np.ndarray | None = None
    """[3] float64, unit, in the model's world; None: unknown."""
    tilt: float = math.nan
    """Standard deviation of the up direction, degrees; set together with `metres`."""
    strays: tuple[tuple[str, float], ...] = ()
    """Outliers: names in the model and errors in metres, largest first; weight 0 in the fit."""
    contradicts: float | None = None
    """Metres by which places are off, typically, where they agree too little with the model for a
    size; None: they agree, or are too few or too close together to tell one."""


def read_gps(model: Any, places: dict[int, np.ndarray]) -> Gps:
    """Scale and up direction from the GPS positions of photos.

    Args:
        model: pycolmap's Reconstruction.
        places: Latitude and longitude in degrees and height in metres, [3], by number of the image.
    """
    numbers = sorted(set(places) & set(model.reg_image_ids()))
    if len(numbers) < LEAST_PLACES:
        return Gps()
    there = _in_metres(np.array([places[number] for number in numbers], np.float64))
    centers = np.array([model.images[number].projection_center() for number in numbers])
    weights = _agreement(centers, there)
    rotation, metres, placed, errors = _fit(centers, there, weights)
    sizes, kept = np.linalg.norm(errors, axis=1), weights > 0
    if 2 * np.linalg.norm(placed[kept], axis=1).max() < _LEAST_EXTENT:
        return Gps()
    usual = float(np.median(sizes))
    few = kept.sum() < max(LEAST_PLACES, len(kept) // 2 + 1)
    if few or _scale_error(placed, errors, weights) > _MOST_SCALE_ERROR:
        return Gps(contradicts=usual)
    tilt = _tilt(placed, errors, weights)
    strays = sorted(np.flatnonzero(~kept), key=lambda i: -sizes[i])
    return Gps(
        metres,
        rotation[2] if tilt <= _MOST_TILT else None,
        tilt,
        tuple((model.images[numbers[i]].name, float(sizes[i])) for i in strays),
    )


def places_in_metres(file: Path) -> dict[str, np.ndarray]:
    """Where the photos of a database were taken, [3] float64 to the east, to the north and up of
    the place in their middle in metres, by alias; only those of which EXIF tells it."""
    places = database.gps_places(file)
    if not places:
        return {}
    names, there = database.aliases(file), _in_metres(np.array(list(places.values())))
    return dict(zip((names[number] for number in places), there, strict=True))


def to_metres(model: Any, gps: Gps) -> None:
    """Scale a pycolmap Reconstruction to metres if `gps.metres` is known."""
    if gps.metres is not None:
        p = colmap()
        model.transform(p.Sim3d(gps.metres, p.Rotation3d(), np.zeros(3)))


def _in_metres(geodetic: np.ndarray) -> np.ndarray:
    """Places [n, 3] in metres to the east, to the north and up of the one in their middle.

    That is one that most others are near, since up is what is up there: a stray one may lie on the
    other side of the Earth.
    """
    transform = colmap().GPSTransform()
    earth = transform.ellipsoid_to_ecef(geodetic)
    middle = np.linalg.norm(earth - np.median(earth, axis=0), axis=1).argmin()
    return transform.ellipsoid_to_enu(geodetic, *geodetic[middle])


def _agreement(centers: np.ndarray, there: np.ndarray) -> np.ndarray:
    """How much each place counts, [n] from 0, stray, to 1.

    Begun with the fit to three photos whose errors are least in the better half of all (least
    median of squares, Rousseeuw 1984), which no stray place can lead away, then fitted again with
    weights by the errors of the fit before.

    Args:
        centers: [n, 3], world.
        there: [n, 3], the same places in metres to the east, to the north and up.
    """
    count, rng = len(centers), np.random.default_rng(0)
    half, least, best = (count + 4) // 2 - 1, math.inf, np.zeros(count)
    for _ in range(_TRIPLES):
        three = np.zeros(count)
        three[rng.choice(count, 3, replace=False)] = 1.0
        sizes = _sizes(centers, there, three)
        if (error := np.partition(sizes, half)[half]) < least:
            least, best = error, sizes
    weights = (best <= least).astype(np.float64)
    for _ in range(_ROUNDS):
        weights = _weights(_sizes(centers, there, weights))
    return weights


def _weights(sizes: np.ndarray) -> np.ndarray:
    """How much places count whose errors are `sizes` [n] in metres."""
    usual = max(float(np.median(sizes)), _EXACT)
    weights = np.minimum(1.0, _LESS * usual / np.maximum(sizes, _EXACT))
    return np.where(sizes > max(_STRAY * usual, _STRAY_METRES), 0.0, weights)


def _sizes(centers: np.ndarray, there: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """[n] metres by which GPS is off from where a fit leads to."""
    return np.linalg.norm(_fit(centers, there, weights)[-1], axis=1)


def _fit(
    centers: np.ndarray, there: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:
    """The similarity from the world to metres (Umeyama 1991): its rotation [3, 3], its factor, the
    places it leads to about their middle [n, 3], and how far GPS is off from these [n, 3]."""
    total = weights.sum()
    a = centers - weights @ centers / total
    b = there - weights @ there / total
    u, s, vt = np.linalg.svd((b * weights[:, None]).T @ a)
    flip = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = u * flip @ vt
    scale = float((s * flip).sum() / max(weights @ (a**2).sum(axis=1), np.finfo(float).tiny))
    placed = a @ rotation.T * scale
    return rotation, scale, placed, b - placed


def _variance(errors: np.ndarray, weights: np.ndarray) -> float:
    """Of one coordinate of a place, m^2, for as many places as count.

    Heights of GPS are worse than the rest, so theirs count where they are larger.
    """
    count = int((weights > 0).sum())
    overall = weights @ (errors**2).sum(axis=1) / max(3 * count - 7, 1)
    heights = weights @ errors[:, 2] ** 2 / max(count - 3, 1)
    return float(max(overall, heights)) * count / min(count, _INDEPENDENT)


def _scale_error(placed: np.ndarray, errors: np.ndarray, weights: np.ndarray) -> float:
    """Relative standard deviation of a fitted size."""
    inertia = float(weights @ (placed**2).sum(axis=1))
    return math.sqrt(_variance(errors, weights) / max(inertia, _EXACT**2))


def _tilt(placed: np.ndarray, errors: np.ndarray, weights: np.ndarray) -> float:
    """Degrees, a standard deviation, by which a fitted rotation may lean.

    The variance of a small turn about one of the places' main axes is the errors' variance over
    their inertia about it. About a line on which all lie nothing is known, and the turn may be any.
    """
    variance = _variance(errors, weights)
    outer = np.einsum("n,ni,nj->ij", weights, placed, placed)
    inertia, axes = np.linalg.eigh(np.trace(outer) * np.eye(3) - outer)
    turns = np.minimum(variance / np.maximum(inertia, _EXACT**2), _ANY_TURN)
    covariance = axes * turns @ axes.T
    leaning = float(np.linalg.eigvalsh(covariance[:2, :2])[-1])  # about the axes that are level
    return math.degrees(math.sqrt(leaning))
