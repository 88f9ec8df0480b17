"""Moment merge: one splat from several, with their mean, covariance, colour and covered area."""

from dataclasses import dataclass

import numpy as np

from ..splats import Splats, sigmoid
from ..transforms import quat_to_rotmat, rotmat_to_quat

_POWER = 1.6075
"""Exponent of Thomsen's formula for the surface of an ellipsoid, accurate to 1.1 %."""
_LEAST_WEIGHT = 1e-30
_MOST_OPAQUE = 1 - 1e-6
_LOG_RANGE = 80.0
"""Largest absolute log scale, so that squares and products of sizes stay finite."""


@dataclass(frozen=True, kw_only=True)
class MergedSplats:
    """Merged splats of groups."""

    splats: Splats
    errors: np.ndarray
    """[G] float64, displacement of the members, see `merged_by`, world units."""


def projected_area(splats: Splats) -> np.ndarray:
    """[N] float64, above 0: opacity times the projected area, averaged over all directions.

    The mean projected area of a convex body is a quarter of its surface (Cauchy 1832), here of the
    ellipsoid of one standard deviation, without the factor pi.
    """
    return np.maximum(sigmoid(splats.opacities) * _shadow(_sizes(splats)), _LEAST_WEIGHT)


def median_sizes(splats: Splats) -> np.ndarray:
    """[N] float64, median of the three standard deviations, for a disc its radius, world units."""
    return np.sort(_sizes(splats), axis=1)[:, 1]


def merged_by(splats: Splats, errors: np.ndarray, group: np.ndarray, count: int) -> MergedSplats:
    """Merge each group to one splat.

    Mean, covariance and SH coefficients are averages weighted by `projected_area`; the covariance
    includes that between the means. The opacity preserves the covered area, but is limited to that
    of all splats stacked; beyond that the splat grows. The error is the RMS displacement, by the
    same weights: a distance d counts as d^2 / sqrt(d^2 + s^2) for a splat of size s, because a
    small shift of a wide splat is hardly visible.

    Args:
        splats: [N] splats.
        errors: [N] float64, errors of the splats themselves, world units.
        group: [N] int64, 0 to `count` - 1, each at least once.
        count: Number of groups.
    """
    weights = projected_area(splats)
    total = _sums(weights, group, count)
    share = weights / total[group]
    centers = splats.means.astype(np.float64)
    means = _sums(share[:, None] * centers, group, count)
    apart = centers - means[group]
    spread = _covariances(splats) + apart[:, :, None] * apart[:, None, :]
    covariances = _sums(share[:, None, None] * spread, group, count)
    quats, sizes = _axes(covariances)
    between = _sums(share * (apart**2).sum(axis=1), group, count)
    spread_out = between / np.trace(covariances, axis1=1, axis2=2)
    opacities, widened = _opacities(splats, _shadow(sizes), total, spread_out, group)
    sizes = sizes * widened[:, None]
    squares = (apart**2).sum(axis=1)
    visible = squares * squares / np.maximum(squares + median_sizes(splats) ** 2, 1e-300)
    moved = errors**2 + visible
    colors = [
        _sums(share[:, None, None] * rest.astype(np.float64), group, count).astype(np.float32)
        for rest in (splats.sh0, splats.shN)
    ]
    return MergedSplats(
        splats=Splats(
            means=means.astype(np.float32),
            quats=quats.astype(np.float32),
            scales=np.log(sizes).astype(np.float32),
            opacities=np.log(opacities / (1 - opacities)).astype(np.float32),
            sh0=colors[0],
            shN=colors[1],
        ),
        errors=np.sqrt(_sums(share * moved, group, count)),
    )


def _opacities(
    splats: Splats, shadow: np.ndarray, total: np.ndarray, spread_out: np.ndarray, group: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Opacities [G], strictly between 0 and 1, and factors of the sizes [G], at least 1.

    Splats in one place have the opacity of a stack over the area of one. Splats next to each other
    fill a shape evenly, which covers up to twice the area of a Gaussian with that covariance.
    `spread_out`, the share of the covariance that is between the means, interpolates.
    """
    clear = np.log1p(-np.minimum(sigmoid(splats.opacities), _MOST_OPAQUE))
    stacked = np.clip(-np.expm1(_sums(clear, group, len(total))), 1e-9, _MOST_OPAQUE)
    covered = np.minimum(total / shadow, stacked * (1 + spread_out))
    opacities = np.clip(np.minimum(covered, stacked), 1e-9, _MOST_OPAQUE)
    return opacities, np.sqrt(np.maximum(covered / opacities, 1.0))


def _sizes(splats: Splats) -> np.ndarray:
    return np.exp(np.clip(splats.scales.astype(np.float64), -_LOG_RANGE, _LOG_RANGE))


def _shadow(sizes: np.ndarray) -> np.ndarray:
    """[N] mean projected area of ellipsoids with these half-axes [N, 3]; Thomsen's formula."""
    a, b, c = sizes.T
    # Divided by the largest product first, because powers of the products could overflow.
    products = np.stack([a * b, a * c, b * c])
    largest = np.maximum(products.max(axis=0), 1e-300)
    return largest * ((products / largest) ** _POWER).mean(axis=0) ** (1 / _POWER)


def _covariances(splats: Splats) -> np.ndarray:
    """[N, 3, 3] float64."""
    axes = quat_to_rotmat(splats.quats.astype(np.float64)) * _sizes(splats)[:, None, :]
    return axes @ np.swapaxes(axes, 1, 2)


def _axes(covariances: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Quaternions [G, 4] and standard deviations [G, 3] of covariances [G, 3, 3]."""
    values, vectors = np.linalg.eigh(covariances)
    vectors[np.linalg.det(vectors) < 0, :, 0] *= -1
    # Rounding errors of the thin side of a disc are a millionth of its wide side.
    least = np.maximum(values[:, 2:] * 1e-12, 1e-60)
    return rotmat_to_quat(vectors), np.sqrt(np.maximum(values, least))


def _sums(values: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """Sums of rows [N, ...] by group, [count, ...] float64."""
    flat = values.reshape(len(values), -1)
    order = np.argsort(group, kind="stable")
    starts = np.searchsorted(group[order], np.arange(count))
    return np.add.reduceat(flat[order], starts, axis=0).reshape(count, *values.shape[1:])
