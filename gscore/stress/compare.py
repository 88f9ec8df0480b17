"""Comparison of a rendered scene with the reference: errors, and checks for empty pictures."""

import math

import numpy as np

from .case import EmptyTestError, Measure
from .native import PICTURES, Drawn
from .truth import Truth

INTERIOR, FLIP_ERROR, FLIP_RATE = 1e-5, 1e-3, 1e-3
"""Largest error outside the band; error of a flipped pixel, and their largest share."""
MEDIAN, TAIL = 1e-5, 1e-3
"""Median and 99.9th percentile of the gradients' errors, relative to their rows."""
_NOTHING = 1e-30
"""Largest float32 result for a zero in float64, such as 1 - sigmoid(1000)."""
ROW_FLOOR, NUMBER_FLOOR = 0.01, 0.1
"""Minimum length of rows in relative errors, as a share of the median row; the second for rows of a
single number. Errors of shorter rows measure the cancellation of sums: plain float32 torch has the
same tails on these rows."""


def require_covered(alpha: np.ndarray) -> None:
    """Raise EmptyTestError unless the picture shows splats, on average and in each row."""
    if not alpha.mean() > 0.1:
        raise EmptyTestError(f"the picture is nearly empty: mean alpha {alpha.mean():.3f}")
    if not (alpha > 0).any(axis=1).all():
        raise EmptyTestError("a row of the picture shows no splat")


def picture_errors(drawn: Drawn, truth: Truth) -> np.ndarray:
    """[H, W] largest error of all pictures, each relative to max(1, its largest value)."""
    worst = np.zeros(truth.band.shape)
    for name in PICTURES:
        true = truth.pictures[name]
        error = np.abs(drawn.pictures[name] - true) / max(1.0, float(np.abs(true).max()))
        worst = np.fmax(worst, error.reshape(*truth.band.shape, -1).max(axis=2))
        # NaN is an infinite error.
        worst[~np.isfinite(error).reshape(*truth.band.shape, -1).all(axis=2)] = np.inf
    return worst


def picture_measures(
    drawn: Drawn,
    truth: Truth,
    *,
    tolerance: float = INTERIOR,
    mean: float | None = None,
    most_band: float = 0.1,
) -> list[Measure]:
    """Largest and mean error outside the band, and the share of flipped pixels.

    The tolerance of the mean is `mean`, by default 1/20 of the largest.
    """
    require_covered(truth.pictures["alpha"])
    if not truth.band.mean() < most_band:
        raise EmptyTestError(f"{truth.band.mean():.0%} of the pixels are undecided")
    error = picture_errors(drawn, truth)
    inside = error[~truth.band]
    # One pixel of a small picture exceeds the rate, but is not evidence.
    flipped = max(0, int((error > FLIP_ERROR).sum()) - 1) / error.size
    return [
        Measure("picture", float(inside.max()), tolerance),
        Measure("picture, mean", float(inside.mean()), mean or tolerance / 20),
        Measure("flipped pixels", flipped, FLIP_RATE),
    ]


def row_errors(actual: np.ndarray, true: np.ndarray) -> np.ndarray:
    """|error| / |row of the truth|, flat; infinite if a row should be zero and is not."""
    a = actual.astype(np.float64).reshape(len(actual), -1)
    t = true.reshape(len(true), -1)
    length = np.linalg.norm(t, axis=1)
    seen = length > 0
    if (np.abs(a[~seen]) > _NOTHING).any() or not np.isfinite(a).all():
        return np.array([np.inf])
    if not seen.any():
        raise EmptyTestError("the true gradient is zero everywhere")
    floor = (NUMBER_FLOOR if t.shape[1] == 1 else ROW_FLOOR) * float(np.median(length[seen]))
    return (np.abs(a - t)[seen] / np.maximum(length[seen], floor)[:, None]).ravel()


def gradient_measures(drawn: Drawn, truth: Truth) -> list[Measure]:
    """Median and 99.9th percentile of the worst parameter; the camera is one row."""
    medians, tails = {}, {}
    for name, true in truth.gradients.items():
        actual = drawn.gradients[name]
        if true.size == 0 or (name == "shN" and not true.any() and not actual.any()):
            continue  # degree 0
        if name == "viewmat":
            actual, true = actual.reshape(1, 16), true.reshape(1, 16)
        errors = row_errors(actual, true)
        medians[name] = float(np.median(errors))
        tails[name] = float(np.quantile(errors, 0.999))
    worst = max(tails, key=lambda name: tails[name])
    return [
        Measure("gradient, median", max(medians.values()), MEDIAN),
        Measure("gradient, 99.9 %", tails[worst], TAIL, f"worst: {worst}"),
    ]


def merge(measures: list[Measure]) -> list[Measure]:
    """The worst measure of each name, NaN being the worst, in the order of first occurrence."""
    worst: dict[str, Measure] = {}
    for m in measures:
        old = worst.get(m.what)
        if old is not None and math.isnan(old.error):
            continue
        if old is None or not m.error / (m.tolerance or 1) <= old.error / (old.tolerance or 1):
            worst[m.what] = m
    return list(worst.values())


def different_bits(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> int:
    """Number of elements with different bits."""
    count = 0
    for name, a in one.items():
        b = other[name]
        assert a.shape == b.shape, name
        count += int((a.view(np.uint32) != b.view(np.uint32)).sum())
    return count
