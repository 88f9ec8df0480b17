"""Exposure decision: whether to optimise photo gains, their differences, and initial gains."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...config import Switch, TrainConfig
from ...events import Decision
from ...io.exposure_json import read_exposures
from ...robust import HUBER, SIGMA_PER_MEDIAN
from ..views.photo_gains import STOP, PhotoGains
from .analysis import Analysis
from .photo_visit import TrackColors

_NEIGHBOURS = 4
"""Number of nearest photos that a photo is compared with."""
_OF_START = (
    "Photos keep the exposures of the run of the start splats (exposure.json beside them), so that "
    "this part of the capture matches its surroundings. `--exposure off` uses colours unchanged."
)
_SHARED = 20
"""Least observations of the median photo for a measurement by points."""


@dataclass(frozen=True, kw_only=True)
class Exposure:
    """Exposure decision of a run."""

    gains: PhotoGains | None = None
    """Gains to optimise; None: photo colours are used unchanged."""
    decision: Decision | None = None
    """The decision and its reason; None: no analysis."""
    numbers: dict[str, Any] | None = None
    """Measurements for metrics.json; None: no analysis."""


def decide_exposure(config: TrainConfig, analysis: Analysis) -> Exposure:
    """Fit the exposures of the training photos, and decide whether gains are optimised: always,
    unless disabled or for a single photo (docs/experiments/2026-11-exposure.md).

    Raises:
        FormatError: the exposures beside the start splats of a part are damaged.
    """
    if config.exposure is Switch.OFF:
        return Exposure()
    cameras, train = analysis.photos.scene.cameras, list(analysis.photos.train)
    if analysis.is_part and config.exposure is Switch.AUTO and config.start_splats is not None:
        given = read_exposures(config.start_splats.parent)
        if given and all(cameras.names[i] in given for i in train):
            log_gains = np.zeros((len(cameras), 3))
            log_gains[train] = np.log([given[cameras.names[i]].nearest_gain for i in train])
            return Exposure(
                gains=PhotoGains(train, log_gains, fixed=True),
                decision=Decision("exposure", _OF_START),
                numbers={"learnt": False, "why": _OF_START, "stops_apart": 0.0, "known_by": None},
            )
    colors, stops = analysis.facts.colors, analysis.facts.stops
    measured = (
        colors is not None and np.median(np.bincount(colors.view, minlength=len(train))) >= _SHARED
    )
    expected = np.zeros((len(train), 3))
    if stops is not None:
        expected += ((stops[train] - stops[train].mean()) * STOP)[:, None]
    found = fit_gains(colors, expected) if measured and colors is not None else expected
    known = "points seen in several photos" if measured else "EXIF" if stops is not None else ""
    off = stops_off_neighbours(found, cameras.centers[train])
    spread = float(np.sqrt((off**2).mean())) if len(off) else 0.0
    why_not = _why_not(analysis)
    learns = config.exposure is Switch.ON or not why_not
    why = _reason(spread, float(off.max(initial=0.0)), known=known) if learns else why_not
    log_gains = np.zeros((len(cameras), 3))
    log_gains[train] = found
    return Exposure(
        gains=PhotoGains(train, log_gains) if learns else None,
        decision=Decision("exposure", why),
        numbers={"learnt": learns, "why": why, "stops_apart": spread, "known_by": known or None},
    )


def _why_not(analysis: Analysis) -> str:
    """Return why colours stay as they are unless gains are requested; empty: gains are optimised.

    Gains have the mean 1 over the photos of a training, which for a part of a capture is another
    exposure than for its surroundings.
    """
    if len(analysis.photos.train) < 2:
        return "A single photo has no other exposure to match, so its colours are used unchanged."
    if analysis.is_part:
        return (
            "Colours are used unchanged, so that this part of the capture has the exposure of its "
            "surroundings; `--exposure on` optimises gains."
        )
    return ""


def _reason(spread: float, farthest: float, *, known: str) -> str:
    """Return the decision to optimise gains as a sentence.

    Args:
        spread: Root mean square of `stops_off_neighbours`; 0 if exposures are unknown.
        farthest: Maximum of these.
        known: Source of the exposures; empty: unknown.
    """
    fact = f" ({spread:.2f} stops apart, at most {farthest:.2f}, by {known})" if known else ""
    return (
        f"The exposure of each photo is optimised{fact}; held-out photos get that of their "
        "neighbours, new views the mean. `--exposure off` uses colours unchanged."
    )


def stops_off_neighbours(log_gains: np.ndarray, centers: np.ndarray) -> np.ndarray:
    """Exposure difference of each photo to its nearest photos: on average the standard deviation
    for random exposures, and small for exposures that change smoothly along the camera path.

    Args:
        log_gains: [V, 3] ln gains in encoded values.
        centers: [V, 3] camera positions, any unit.

    Returns:
        [V] float64, stops, root mean square over the channels.
    """
    from scipy.spatial import KDTree

    others = min(_NEIGHBOURS, len(log_gains) - 1)
    if others < 1:
        return np.zeros(len(log_gains))
    near = np.array(KDTree(centers).query(centers, k=others + 1)[1])
    own = np.arange(len(near))[:, None]
    # Cameras in one place come in any order; each is excluded from its own neighbours.
    near[:, -1] = np.where((near == own).any(axis=1), near[:, -1], own[:, 0])
    mean = (log_gains[near].sum(axis=1) - log_gains) / others
    return np.sqrt(((log_gains - mean) ** 2).mean(axis=1) / (1 + 1 / others)) / STOP


_ROUNDS = 12
"""Rounds of reweighting; the gains change by less than 1e-3 in the last ones."""
_PRIOR = 1.0
"""Weight of the expected gain of a photo, in observations."""
_SMALLEST = 1e-3
"""Smallest scale of residuals in ln colour: one byte step of white is four times that."""


def fit_gains(colors: TrackColors, expected: np.ndarray) -> np.ndarray:
    """Return ln gains of the photos, zero on average, [V, 3] float64.

    With c the colour of a point in a photo: ln (c + 0.055) = colour of the point + gain of the
    photo + residual (`gscore.photo_exposure`). Points are eliminated from the normal equations;
    Huber weights, by the residual over all channels, are recomputed in each round.

    Args:
        colors: Colours of points in photos; V photos.
        expected: [V, 3] float64: expected ln gains, for example from EXIF; the result for photos
            that share no point with others.
    """
    _, point = np.unique(colors.point, return_inverse=True)
    views, points = colors.views, int(point.max(initial=-1)) + 1
    weight, gains = np.ones(len(colors)), expected.copy()
    for _ in range(_ROUNDS if len(colors) else 0):
        gains = _solved(colors, point, points, weight, expected)
        rest = colors.log_color - gains[colors.view]
        residual = rest - _mean_by(point, rest, weight, points)[point]
        length = np.sqrt((residual**2).mean(axis=1))
        limit = HUBER * max(SIGMA_PER_MEDIAN * float(np.median(length)), _SMALLEST)
        weight = np.minimum(1.0, limit / np.maximum(length, 1e-12))
    assert gains.shape == (views, 3)
    return gains - gains.mean(axis=0)


def _solved(
    colors: TrackColors, point: np.ndarray, points: int, weight: np.ndarray, expected: np.ndarray
) -> np.ndarray:
    """Weighted least squares: gains [V, 3], with the point colours eliminated."""
    from scipy import sparse

    of_point = np.maximum(np.bincount(point, weight, points), 1e-12)
    pairs = sparse.csr_matrix((weight, (point, colors.view)), (points, colors.views))
    scaled = sparse.diags(1.0 / of_point) @ pairs
    matrix = -(pairs.T @ scaled).toarray()
    np.einsum("ii->i", matrix)[:] += np.bincount(colors.view, weight, colors.views) + _PRIOR
    rest = colors.log_color - _mean_by(point, colors.log_color, weight, points)[point]
    right = np.stack(
        [np.bincount(colors.view, weight * rest[:, c], colors.views) for c in range(3)], axis=1
    )
    return np.linalg.solve(matrix, right + _PRIOR * expected)


def _mean_by(point: np.ndarray, values: np.ndarray, weight: np.ndarray, points: int) -> np.ndarray:
    """[P, 3]: weighted means of values [S, 3] over the observations of each point."""
    total = np.maximum(np.bincount(point, weight, points), 1e-12)
    sums = [np.bincount(point, weight * values[:, c], points) for c in range(3)]
    return np.stack(sums, axis=1) / total[:, None]
