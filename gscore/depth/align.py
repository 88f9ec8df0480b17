"""Alignment of a depth map: scale and offset from SfM points, by two methods."""

import numpy as np

from ..robust import HUBER, SIGMA_PER_MEDIAN
from ..text_format import count_text, number
from .fit import NO_FIT, Fit, fit_of, scale_reason, tolerance
from .maps import sample
from .observations import Observations

REVERSED = "the map is larger where the points are farther: it may contain depth"
"""Refusal of a map that decreases with inverse depth."""
OFFICIAL_POINTS = 10
"""The official rule requires more points than this."""
OFFICIAL_RANGE = 1e-3
"""The official rule requires a larger range of inverse depths than this, 1/world unit."""
LEAST_POINTS = 20
"""Minimum number of inliers of the robust rule."""
LEAST_SHARE = 0.3
"""Minimum share of inliers of the robust rule."""
_LEAST_SPREAD = 0.02
"""Minimum range of the points' inverse depths, relative to their median."""
_LEAST_GAIN = 0.15
"""Minimum share of inliers beyond chance, relative to the points that do not agree by chance."""
_DEVIATIONS = 4.5
"""Minimum excess of the inliers over chance, standard deviations; the best line reaches up to 4."""
_MOST_SLOPE_ERROR = 0.12
"""Maximum relative standard error of the scale."""
_LEAST_SLOPE = 1e-3
"""Minimum slope of map on points, both in units of their spread."""
_DRAWS = 500
_ROUNDS = 20


def align_official(values: np.ndarray, seen: Observations) -> Fit:
    """The rule of the official 3DGS tools, exactly: medians and mean absolute deviations.

    As in those tools, the map is sampled at the observed positions without the half-pixel shift
    between COLMAP's and OpenCV's pixel centres, with both axes scaled by the ratio of heights.
    `scale_reason` then checks the scale against all views.

    Args:
        values: [H, W] float32, inverse depth up to an affine map, finite; PNG values / 65536.
        seen: The points of the view.

    Returns:
        Scale and offset; both 0, and refused, for 10 points or fewer or a range of inverse depths
        of 1e-3 or less.
    """
    ratio = values.shape[0] / seen.height
    x, y = (seen.x * ratio).astype(np.float32), (seen.y * ratio).astype(np.float32)
    inside = (x >= 0) & (y >= 0) & (x < seen.width * ratio) & (y < seen.height * ratio)
    inside &= seen.inverse_depth > 0
    count = int(inside.sum())
    if count <= OFFICIAL_POINTS:
        return NO_FIT.refused(
            f"only {count_text(count, 'point is', 'points are')} seen in it, expected more than 10"
        )
    if np.ptp(seen.inverse_depth) <= OFFICIAL_RANGE:
        return NO_FIT.refused("the inverse depths of its points differ by 0.001 or less")
    known = seen.inverse_depth[inside]
    mono = sample(values, x[inside].astype(np.float64), y[inside].astype(np.float64))
    middle, mono_middle = np.median(known), np.median(mono)
    deviation, mono_deviation = np.abs(known - middle).mean(), np.abs(mono - mono_middle).mean()
    if not mono_deviation > 0:
        return NO_FIT.refused("the map has one value at all points")
    scale = float(deviation / mono_deviation)
    offset = float(middle - mono_middle * scale)
    return fit_of(scale, offset, mono, known, seen.weights[inside])


def align_robust(
    mono: np.ndarray, inverse_depth: np.ndarray, weights: np.ndarray, *, seed: int = 0
) -> Fit:
    """RANSAC over pairs of points, then least squares reweighted by Huber's function.

    Maps have errors of some per cent, points of some tenths of a per cent. So the map's values are
    regressed on the points' inverse depths; the reverse would flatten every noisy map.

    Args:
        mono: [M] values of the map at the points, affine in inverse depth; NaN: unknown.
        inverse_depth: [M] of the points, 1/world unit.
        weights: [M] positive weights of the points.
        seed: Random seed of the pairs; same seed, same fit.

    Returns:
        The fit, refused with a reason if the points are few, at one depth, or do not follow the
        map. The caller checks the scale against all views.
    """
    use = np.isfinite(mono) & np.isfinite(inverse_depth) & (inverse_depth > 0) & (weights > 0)
    m, s, w = mono[use].astype(np.float64), inverse_depth[use].astype(np.float64), weights[use]
    none = Fit(scale=0.0, offset=0.0, points=len(m))
    if len(m) < LEAST_POINTS:
        return none.refused(
            f"only {count_text(len(m), 'point is', 'points are')} seen in it, expected "
            f"{LEAST_POINTS}"
        )
    middle = float(np.median(s))
    low, high = np.quantile(s, (0.05, 0.95))
    if high - low < _LEAST_SPREAD * middle:
        return none.refused("its points are all at the same depth, which gives no scale")
    center = float(np.median(m))
    spread = float(np.subtract(*np.quantile(m, (0.95, 0.05))))
    if not spread > 1e-6 * max(abs(center), np.finfo(np.float32).tiny):
        return none.refused("the map has one value at nearly all points")
    unit = (m - center) / spread, s / middle
    near = tolerance(s) / middle
    slope, height = _refined(*unit, w, near, *_ransac(*unit, w, near, seed))
    scale = slope * middle / spread
    fit = fit_of(scale, height * middle - scale * center, m, s, w)
    inside = round(fit.inliers * len(m))
    if inside < LEAST_POINTS or fit.inliers < LEAST_SHARE:
        return fit.refused(
            f"only {number(inside)} of {count_text(len(m), 'point')} ({fit.inliers:.0%} by "
            "weight) agree with one scale and offset"
        )
    if not is_significant(slope * unit[0] + height, unit[1], w, near):
        return fit.refused("the map does not follow the depth of the points")
    if not scale > 0:
        return fit.refused(REVERSED)
    if fit.slope_error > _MOST_SLOPE_ERROR:
        return fit.refused(
            f"its points are too close in depth for a map of this noise: the scale is only known "
            f"to {fit.slope_error:.0%}"
        )
    return fit


def reliable(fits: list[Fit | None], median: float) -> list[Fit | None]:
    """Refuse fits whose scale differs too much from the median of all views."""
    out: list[Fit | None] = []
    for fit in fits:
        reason = scale_reason(fit.scale, median) if fit is not None and fit.accepted else ""
        out.append(fit.refused(reason) if fit is not None and reason else fit)
    return out


def _ransac(
    m: np.ndarray, s: np.ndarray, w: np.ndarray, near: float, seed: int
) -> tuple[float, float]:
    """Slope and intercept of the line through two points with the least truncated misfit."""
    rng = np.random.default_rng(seed)
    first, second = rng.integers(0, len(m), (2, _DRAWS))
    apart = np.abs(m[first] - m[second]) > 0.05  # close pairs do not constrain the slope
    if not apart.any():
        apart = m[first] != m[second]
    first, second = first[apart], second[apart]
    if len(first) == 0:
        return 0.0, float(np.median(s))
    slope = (s[first] - s[second]) / (m[first] - m[second])
    height = s[first] - slope * m[first]
    misfit = [_misfit(a, b, m, s, w, near) for a, b in zip(slope, height, strict=True)]
    best = int(np.argmin(misfit))
    return float(slope[best]), float(height[best])


def _refined(
    m: np.ndarray, s: np.ndarray, w: np.ndarray, near: float, slope: float, height: float
) -> tuple[float, float]:
    """Iteratively reweighted least squares of m on s from a good initial line.

    Points beyond three deviations have weight 0: with Huber's function alone, many gross errors on
    one side would bias the line.
    """
    for _ in range(_ROUNDS):
        off = np.abs(slope * m + height - s)
        inside = off <= near
        if int(inside.sum()) < 2:
            break
        deviation = max(SIGMA_PER_MEDIAN * _weighted_median(off[inside], w[inside]), 1e-3 * near)
        inside &= off <= 3 * deviation
        weight = w * np.minimum(1.0, HUBER * deviation / np.maximum(off, 1e-300)) * inside
        total = weight.sum()
        mean_m, mean_s = (weight * m).sum() / total, (weight * s).sum() / total
        covariance = (weight * (m - mean_m) * (s - mean_s)).sum()
        variance = (weight * (s - mean_s) ** 2).sum()
        if abs(covariance) <= 1e-12 * total or abs(covariance) < _LEAST_SLOPE * variance:
            break
        before = slope, height
        slope = float(variance / covariance)
        height = float(mean_s - slope * mean_m)
        if abs(slope - before[0]) + abs(height - before[1]) < 1e-9:
            break
    return slope, height


def _misfit(
    slope: float, height: float, m: np.ndarray, s: np.ndarray, w: np.ndarray, near: float
) -> float:
    """Weighted sum of squared differences, each truncated at the tolerance."""
    return float((w * np.minimum((slope * m + height - s) ** 2, near**2)).sum())


def is_significant(line: np.ndarray, s: np.ndarray, w: np.ndarray, near: float) -> bool:
    """Whether more points agree than if each had the map's value of a random other point.

    Where most points are at one depth, a flat line agrees with them for any map.

    Args:
        line: [M] fitted values of the map at the points.
        s: [M] values of the points.
        w: [M] positive weights.
        near: Maximum difference of agreeing values.
    """
    weight = w / w.sum()
    share = float(weight[np.abs(line - s) <= near].sum())
    order = np.argsort(s)
    total = np.concatenate([[0.0], np.cumsum(weight[order])])
    above = np.searchsorted(s[order], line + near, side="right")
    below = np.searchsorted(s[order], line - near, side="left")
    chance = float((weight * (total[above] - total[below])).sum())
    deviation = (chance * (1 - chance) * (weight**2).sum()) ** 0.5
    return share - chance >= max(_LEAST_GAIN * (1 - chance), _DEVIATIONS * deviation)


def _weighted_median(values: np.ndarray, weights: np.ndarray) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, 0.5 * total[-1])])
