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
"""Minimum extent of all photos, metres, because GPS is off by some metres."""
_MOST_SCALE_ERROR = 0.15
"""Maximum relative standard deviation of the scale."""
_MOST_TILT = 4.0
"""Maximum standard deviation of the up direction, degrees: that of a hand-held camera."""
_INDEPENDENT = 10
"""Maximum number of positions with independent errors: GPS errors are correlated for minutes."""
_LESS = 2.5
"""Residual, in medians, from which the weight of a position decreases."""
_STRAY, _STRAY_METRES = 6.0, 10.0
"""Residual, in medians and in metres, above both of which a position is an outlier (weight 0)."""
_TRIPLES = 500
"""Initial fits to three photos: with every second position an outlier, 60 of them have none."""
_REPEATED = 0.4
"""Share of the photos beyond which a position that they have in common is a fix that the camera
repeated, and not used where enough others are left."""
_EXACT = 1e-6
"""Minimum residual of a position, metres."""
_ANY_TURN = math.pi**2 / 3
"""Variance of a uniformly distributed angle."""
_ROUNDS = 20
"""Number of reweighted fits."""


@dataclass(frozen=True)
class Gps:
    """Scale and up direction of a model by GPS."""

    metres: float | None = None
    """Metres per unit of the model; None: unknown."""
    up: np.ndarray | None = None
    """[3] float64, unit, in the model's world; None: unknown."""
    tilt: float = math.nan
    """Standard deviation of the up direction, degrees; set together with `metres`."""
    outliers: tuple[tuple[str, float], ...] = ()
    """Outliers: names in the model and errors in metres, largest first; weight 0 in the fit."""
    repeated: int = 0
    """Number of photos whose position is not used because too many have the same."""
    contradicts: float | None = None
    """Median residual in metres if the positions contradict the model; None: they agree, or are too
    few or too close together for a scale."""


def read_gps(model: Any, places: dict[int, np.ndarray]) -> Gps:
    """Scale and up direction from the GPS positions of photos.

    Args:
        model: pycolmap's Reconstruction.
        places: Latitude and longitude in degrees and height in metres, [3] float64, by image id.
    """
    numbers = sorted(set(places) & set(model.reg_image_ids()))
    if len(numbers) < LEAST_PLACES:
        return Gps()
    fixes = np.array([places[number] for number in numbers], np.float64)
    _, which, counts = np.unique(fixes, axis=0, return_inverse=True, return_counts=True)
    repeated = counts[which.reshape(-1)] > max(_REPEATED * len(fixes), 1)
    lost = int(repeated.sum())
    if len(np.unique(fixes[~repeated], axis=0)) >= LEAST_PLACES:
        numbers = [n for n, same in zip(numbers, repeated, strict=True) if not same]
        fixes = fixes[~repeated]
    elif 2 * lost > len(fixes):  # the median residual is that of the repeated positions
        return Gps(repeated=lost)
    else:
        lost = 0
    there = _in_metres(fixes)
    centers = np.array([model.images[number].projection_center() for number in numbers])
    weights = _agreement(centers, there)
    rotation, metres, placed, errors = _fit(centers, there, weights)
    sizes, kept = np.linalg.norm(errors, axis=1), weights > 0
    if 2 * np.linalg.norm(placed[kept], axis=1).max() < _LEAST_EXTENT:
        return Gps(repeated=lost)
    usual = float(np.median(sizes))
    few = kept.sum() < max(LEAST_PLACES, len(kept) // 2 + 1)
    if few or _scale_error(placed, errors, weights) > _MOST_SCALE_ERROR:
        return Gps(repeated=lost, contradicts=usual)
    tilt = _tilt(placed, errors, weights)
    outliers = sorted(np.flatnonzero(~kept), key=lambda i: -sizes[i])
    return Gps(
        metres,
        rotation[2] if tilt <= _MOST_TILT else None,
        tilt,
        tuple((model.images[numbers[i]].name, float(sizes[i])) for i in outliers),
        lost,
    )


def places_in_metres(file: Path) -> dict[str, np.ndarray]:
    """GPS positions of the photos of a database by alias, [3] float64: metres east, north and up of
    a central photo; photos without GPS are missing."""
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
    """Positions [n, 3] in metres east, north and up of a central one.

    The origin is the position nearest to the median, because it defines up: an outlier may be on
    the other side of the Earth.
    """
    transform = colmap().GPSTransform()
    earth = transform.ellipsoid_to_ecef(geodetic)
    middle = np.linalg.norm(earth - np.median(earth, axis=0), axis=1).argmin()
    return transform.ellipsoid_to_enu(geodetic, *geodetic[middle])


def _agreement(centers: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Weight of each position, [n] float64 from 0, an outlier, to 1.

    Starts from the fit to three photos with the least median residual (least median of squares,
    Rousseeuw 1984), which is robust to outliers, and continues with reweighted fits.

    Args:
        centers: [n, 3], world.
        there: [n, 3], the same positions in metres east, north and up.
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
    """Weights of positions with residuals `sizes` [n] in metres."""
    usual = max(float(np.median(sizes)), _EXACT)
    weights = np.minimum(1.0, _LESS * usual / np.maximum(sizes, _EXACT))
    return np.where(sizes > max(_STRAY * usual, _STRAY_METRES), 0.0, weights)


def _sizes(centers: np.ndarray, there: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Residuals [n] of a fit, metres."""
    return np.linalg.norm(_fit(centers, there, weights)[-1], axis=1)


def _fit(
    centers: np.ndarray, there: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:
    """Fit the similarity from the world to metres (Umeyama 1991): rotation [3, 3], factor, mapped
    centres relative to their mean [n, 3], and residuals of GPS [n, 3]."""
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
    """Variance of one coordinate of a position, m^2, scaled for correlated errors.

    GPS heights are less accurate than the rest, so their variance is used where it is larger.
    """
    count = int((weights > 0).sum())
    overall = weights @ (errors**2).sum(axis=1) / max(3 * count - 7, 1)
    heights = weights @ errors[:, 2] ** 2 / max(count - 3, 1)
    return float(max(overall, heights)) * count / min(count, _INDEPENDENT)


def _scale_error(placed: np.ndarray, errors: np.ndarray, weights: np.ndarray) -> float:
    """Relative standard deviation of the fitted scale."""
    inertia = float(weights @ (placed**2).sum(axis=1))
    return math.sqrt(_variance(errors, weights) / max(inertia, _EXACT**2))


def _tilt(placed: np.ndarray, errors: np.ndarray, weights: np.ndarray) -> float:
    """Standard deviation of the tilt of a fitted rotation, degrees.

    The variance of a small rotation about a principal axis of the positions is the variance of the
    residuals over their moment of inertia about it. If all positions are on one line, the rotation
    about it is unknown, and may have any angle.
    """
    variance = _variance(errors, weights)
    outer = np.einsum("n,ni,nj->ij", weights, placed, placed)
    inertia, axes = np.linalg.eigh(np.trace(outer) * np.eye(3) - outer)
    turns = np.minimum(variance / np.maximum(inertia, _EXACT**2), _ANY_TURN)
    covariance = axes * turns @ axes.T
    leaning = float(np.linalg.eigvalsh(covariance[:2, :2])[-1])  # about the horizontal axes
    return math.degrees(math.sqrt(leaning))
