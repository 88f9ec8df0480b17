"""The affine map from a depth map's values to inverse depth, and how good it is."""

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
    """Points of structure from motion that were compared."""
    error: float = float("nan")
    """Median relative difference of inverse depths over all points; NaN where there are none."""
    accepted: bool = False
    """Whether scale and offset may be used."""
    reason: str = ""
    """Why it was refused, a clause without a full stop; empty if accepted."""

    def refused(self, reason: str) -> Self:
        """The same fit, not to be used."""
        return replace(self, accepted=False, reason=reason)


NO_FIT = Fit(scale=0.0, offset=0.0)
"""A view about which nothing is known."""

LOW, HIGH = 0.2, 5.0
"""A scale outside these multiples of the median scale of all views is unreliable."""


def median_scale(scales: list[float]) -> float:
    """Median of the positive scales; 0 if there is none."""
    positive = [scale for scale in scales if scale > 0]
    return float(np.median(positive)) if positive else 0.0


def scale_reason(scale: float, median: float) -> str:
    """Why a scale is unreliable next to the median of all views; empty if it is not.

    The rule of the official 3DGS trainer.
    """
    if LOW * median <= scale <= HIGH * median:
        return ""
    return (
        f"its scale {scale:.3g} lies outside {LOW:g} to {HIGH:g} times the median {median:.3g} of "
        f"all views"
    )


def agreement(
    scale: float, offset: float, mono: np.ndarray, inverse_depth: np.ndarray, weights: np.ndarray
) -> tuple[float, float]:
    """Weighted share of points within `tolerance` of a fit, and median relative difference."""
    if len(mono) == 0:
        return 0.0, float("nan")
    difference = np.abs(scale * mono + offset - inverse_depth)
    inside = difference <= tolerance(inverse_depth)
    share = float(weights[inside].sum() / weights.sum())
    return share, float(np.median(difference / inverse_depth))


def tolerance(inverse_depth: np.ndarray) -> float:
    """How far an inlier may lie from the fit, 1/world unit.

    5 % of the median; less where all points lie at similar depths, or any fit would do.
    """
    low, high = np.quantile(inverse_depth, (0.05, 0.95))
    return float(min(0.05 * np.median(inverse_depth), 0.15 * (high - low)))
