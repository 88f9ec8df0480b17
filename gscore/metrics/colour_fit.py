"""Colour fit: the error after colour correction by a gain and an offset per channel, fitted on one
half of a picture and evaluated on the other."""

import numpy as np

_FLAT = 1.0 / 255.0
"""A render whose standard deviation in the fitted half is smaller says nothing about gain: what
varies there is rounding of 8 bit."""
_ROUNDING = 1e-24
"""A mean squared error below this is float64's rounding in the fit, not a difference."""


def corrected_mse(
    image: np.ndarray, target: np.ndarray, weight: np.ndarray | None = None
) -> float | None:
    """Mean squared error of a picture whose colours were corrected by its other half.

    The halves lie left and right of the column that divides the weights most evenly: side by side,
    since pixels of a finer pattern would be fitted and judged by the same objects. Each half is
    corrected by the fit of the other and clamped to [0, 1]; errors of both are averaged.

    Args:
        image, target: [3, H, W] float64 in [0, 1].
        weight: [H, W] float64 weights of the pixels, not negative; None: all alike.

    Returns:
        The error, 0 where only rounding is left, or None where one half would hold no weight.
    """
    height, width = image.shape[1:]
    columns = np.full(width, float(height)) if weight is None else weight.sum(axis=0)
    middle = _middle(columns)
    if middle is None:
        return None
    halves = [
        (image[:, :, part], target[:, :, part], None if weight is None else weight[:, part])
        for part in (slice(None, middle), slice(middle, None))
    ]
    left, right = (fit_colours(*half) for half in halves)
    total = _squared_error(*halves[0], *right) + _squared_error(*halves[1], *left)
    mse = total / (3 * float(columns.sum()))
    return mse if mse > _ROUNDING else 0.0


def fit_colours(
    image: np.ndarray, target: np.ndarray, weight: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """The gain >= 0 and the offset per channel with the least squared error to the target.

    On these pixels the result is never worse than no correction, which is gain 1 and offset 0.
    Where the picture is flat the gain stays 1.

    Args:
        image, target: [3, H, W] float64.
        weight: [H, W] float64, not all zero, or None.

    Returns:
        [3] gain, [3] offset, float64.
    """
    mean, aim = _mean(image, weight), _mean(target, weight)
    centred = image - mean[:, None, None]
    pull = centred if weight is None else centred * weight
    total = image[0].size if weight is None else weight.sum()
    variance = np.einsum("chw,chw->c", pull, centred) / total
    # The weighted sum of `pull` is zero, so the target needs no centring.
    covariance = np.einsum("chw,chw->c", pull, target) / total
    flat = variance < _FLAT**2
    gain = np.where(flat, 1.0, np.maximum(covariance, 0.0) / np.where(flat, 1.0, variance))
    return gain, aim - gain * mean


def _mean(planes: np.ndarray, weight: np.ndarray | None) -> np.ndarray:
    if weight is None:
        return planes.mean(axis=(1, 2))
    return np.einsum("chw,hw->c", planes, weight) / weight.sum()


def _squared_error(
    image: np.ndarray,
    target: np.ndarray,
    weight: np.ndarray | None,
    gain: np.ndarray,
    offset: np.ndarray,
) -> float:
    """Sum over pixels and channels of a half that is corrected by the fit of the other."""
    corrected = image * gain[:, None, None]
    corrected += offset[:, None, None]
    np.clip(corrected, 0.0, 1.0, out=corrected)
    corrected -= target
    if weight is None:
        return float(np.einsum("chw,chw->", corrected, corrected))
    return float(np.einsum("chw,chw,hw->", corrected, corrected, weight))


def _middle(columns: np.ndarray) -> int | None:
    """How many columns the left half has, or None where one of the halves must be empty."""
    before = np.cumsum(columns)[:-1]
    if before.size == 0:
        return None
    total = columns.sum()
    middle = int(np.argmin(np.abs(before - total / 2)))
    return middle + 1 if 0 < before[middle] < total else None
