"""Affine fit from the values of a depth map to inverse depth, with its quality."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Fit:
    """Inverse depth in 1/world unit = `scale` * value of the map + `offset`."""

    scale: float
    """1/world unit per unit of the map."""
    offset: float
    """1/world unit."""
    inliers: float = 0.0
    """Share of the points, by weight, that agree with the fit, in [0, 1]."""
    points: int = 0
    """Number of SfM points compared."""
    error: float = float("nan")
    """Median relative difference of inverse depths over all points; NaN where there are none."""
    center: float = 0.0
    """Mean of the map's values at the inliers."""
    deviation: float = 0.0
    """Standard deviation of the map's values at the inliers."""
    noise: float = 0.0
    """Standard deviation of the inliers from the fit, 1/world unit."""
    accepted: bool = False
    """Whether scale and offset may be used."""
    reason: str = ""
    """Reason of a refusal, a clause without a full stop; empty if accepted."""

    @property
    def slope_error(self) -> float:
        """Relative standard error of `scale`; infinite if the points do not constrain it."""
        spread = abs(self.scale) * self.deviation * _INDEPENDENT**0.5
        return self.noise / spread if spread > 0 else float("inf")

    def relative_error(self, values: np.ndarray) -> np.ndarray:
        """Expected relative error of the fitted inverse depth at a map's values.

        It covers the fit only: small among the points, and growing with the distance of a value
        from theirs. Errors of the map at single pixels are excluded.

        Args:
            values: [...] float32 of the map.

        Returns:
            [...] float32; infinite where the inverse depth is not positive.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            away = (values - np.float32(self.center)) / np.float32(self.deviation or 1.0)
            error = np.sqrt((1 + away**2) / _INDEPENDENT) * np.float32(_UNDERSTATED * self.noise)
            inverse = np.float32(self.scale) * values + np.float32(self.offset)
            return np.where(inverse > 0, error / inverse, np.float32(np.inf))

    def refused(self, reason: str) -> Self:
        """The same fit, refused."""
        return replace(self, accepted=False, reason=reason)


_INDEPENDENT = 12
"""Number of independent points: errors of a map are correlated over large parts of it, so thousands
of points constrain its scale no better than a dozen."""

_UNDERSTATED = 4.0
"""Factor on the error estimated from scatter and number of the inliers. Inliers are selected for
agreement, and a map's error grows away from them: in simulated maps of the studio capture the true
error is 0.6 to 10 times the estimate, median 2.8."""

NO_FIT = Fit(scale=0.0, offset=0.0)
"""Fit of a view without information."""

LOW, HIGH = 0.2, 5.0
"""Multiples of the median scale of all views between which a scale is reliable."""


def noise_of(error: float) -> float:
    """`Fit.noise` for a given expected error among the points, 1/world unit."""
    return error * _INDEPENDENT**0.5 / _UNDERSTATED


def median_scale(scales: list[float]) -> float:
    """Median of the positive scales; 0 if there is none."""
    positive = [scale for scale in scales if scale > 0]
    return float(np.median(positive)) if positive else 0.0


def scale_reason(scale: float, median: float) -> str:
    """Why a scale is unreliable relative to the median of all views; empty if it is reliable.

    The rule of the official 3DGS trainer.
    """
    if LOW * median <= scale <= HIGH * median:
        return ""
    return (
        f"its scale {scale:.3g} is outside {LOW:g} to {HIGH:g} times the median {median:.3g} of "
        f"all views"
    )


def fit_of(
    scale: float, offset: float, mono: np.ndarray, inverse_depth: np.ndarray, weights: np.ndarray
) -> Fit:
    """Fit of a given scale and offset with its quality at the points; accepted for now.

    Args:
        scale: 1/world unit per unit of the map.
        offset: 1/world unit.
        mono: [M] finite values of the map at the points.
        inverse_depth: [M] positive, 1/world unit.
        weights: [M] positive.
    """
    fit = Fit(scale=scale, offset=offset, points=len(mono), accepted=True)
    if len(mono) == 0:
        return fit
    difference = np.abs(scale * mono + offset - inverse_depth)
    inside = difference <= tolerance(inverse_depth)
    fit = replace(
        fit,
        inliers=float(weights[inside].sum() / weights.sum()),
        error=float(np.median(difference / inverse_depth)),
    )
    if not inside.any():
        return fit
    return replace(
        fit,
        center=float(mono[inside].mean()),
        deviation=float(mono[inside].std()),
        noise=float(np.sqrt((difference[inside] ** 2).mean())),
    )


def tolerance(inverse_depth: np.ndarray) -> float:
    """Maximum residual of an inlier, 1/world unit.

    5 % of the median; less if all points are at similar depths, where any fit would agree.
    """
    low, high = np.quantile(inverse_depth, (0.05, 0.95))
    return float(min(0.05 * np.median(inverse_depth), 0.3 * (high - low)))
