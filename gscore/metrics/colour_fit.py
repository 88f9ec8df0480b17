"""Colour fit: error after colour correction by gain and offset per channel, fitted on one half of a
picture and evaluated on the other."""

import numpy as np

_FLAT = 1.0 / 255.0
"""Minimum standard deviation of a render in the fitted half to fit a gain; less is 8-bit
rounding."""
_ROUNDING = 1e-24
"""Mean squared error below which only float64 rounding of the fit is left."""


def corrected_mse(
    image: np.ndarray, target: np.ndarray, weight: np.ndarray | None = None
) -> float | None:
    """Mean squared error after colour correction, each half by the fit of the other.

    The column that divides the weights most evenly separates the halves. They are contiguous,
    because in a finer pattern fit and evaluation would share the same objects. Each half is
    corrected by the fit of the other and clamped to [0, 1]; the errors are averaged.

    Args:
        image, target: [3, H, W] float64 in [0, 1].
        weight: [H, W] float64 weights of the pixels, not negative; None: uniform.

    Returns:
        The error, 0 if only rounding is left, or None if one half would have no weight.
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
    """Gain >= 0 and offset per channel with the least squared error to the target.

    On these pixels the result is never worse than gain 1 and offset 0. The gain is 1 if the picture
    is flat.

    Args:
        image, target: [3, H, W] float64.
        weight: [H, W] float64, not all zero, or None.

    Returns:
        [3] gain, [3] offset, float64.
    """
    mean, aim = _mean(image, weight), _mean(target, weight)
    centred = image - mean[:, None, None]
    weighted = centred if weight is None else centred * weight
    total = image[0].size if weight is None else weight.sum()
    variance = np.einsum("chw,chw->c", weighted, centred) / total
    # The sum of `weighted` is zero, so the target needs no centring.
    covariance = np.einsum("chw,chw->c", weighted, target) / total
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
    """Sum of squared errors of a half after correction by the fit of the other."""
    corrected = image * gain[:, None, None]
    corrected += offset[:, None, None]
    np.clip(corrected, 0.0, 1.0, out=corrected)
    corrected -= target
    if weight is None:
        return float(np.einsum("chw,chw->", corrected, corrected))
    return float(np.einsum("chw,chw,hw->", corrected, corrected, weight))


def _middle(columns: np.ndarray) -> int | None:
    """Number of columns in the left half, or None if one half would be empty."""
    before = np.cumsum(columns)[:-1]
    if before.size == 0:
        return None
    total = columns.sum()
    middle = int(np.argmin(np.abs(before - total / 2)))
    return middle + 1 if 0 < before[middle] < total else None
