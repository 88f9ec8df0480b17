"""Gain fit: photo gains from the colours of shared points, by robust least squares."""

import numpy as np

from .track_colors import TrackColors

_ROUNDS = 12
"""Rounds of reweighting; the gains change by less than 1e-3 in the last ones."""
_TUNING = 1.345
"""Standard deviations beyond which residuals are down-weighted (Huber 1964)."""
_SIGMA = 1.4826
"""Standard deviation per median absolute value, of a normal distribution."""
_PRIOR = 1.0
"""Weight of the expected gain of a photo, in observations."""
_SMALLEST = 1e-3
"""Smallest scale of residuals in ln colour: one byte step of white is four times that."""


def fit_gains(colors: TrackColors, expected: np.ndarray) -> np.ndarray:
    """Return ln gains of the photos, zero on average, [V, 3] float64.

    With c the colour of a point in a photo: ln c = colour of the point + gain of the photo +
    residual. Points are eliminated from the normal equations; Huber weights, by the residual over
    all channels, are recomputed in each round.

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
        limit = _TUNING * max(_SIGMA * float(np.median(length)), _SMALLEST)
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
