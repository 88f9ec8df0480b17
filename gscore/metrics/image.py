"""Image metrics: PSNR, SSIM, D-SSIM and MS-SSIM in float64."""

import math
from typing import Any, Literal

import numpy as np

from ..errors import ShapeError
from ..extras import need
from ..shared_constants import SSIM_C1, SSIM_C2, SSIM_SIGMA, SSIM_WINDOW
from .colour_fit import corrected_mse, fit_colours

EMPTY_MASK = "the mask leaves no pixel"
"""Reason for a completely masked view."""
MS_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)
"""Exponents of the five scales of MS-SSIM, finest first (Wang et al. 2003, section 3.2)."""
MS_SMALLEST = (SSIM_WINDOW - 1) * 2 ** (len(MS_WEIGHTS) - 1) + 1
"""Minimum side for MS-SSIM, px, so that the window fits into the coarsest scale."""


def as_float(name: str, image: Any) -> np.ndarray:
    """`image` as float64 clamped to [0, 1].

    Args:
        name: Name of the picture in errors.
        image: [H, W, 3] numpy array or torch tensor; float with 1.0 = white, or uint8.

    Raises:
        ShapeError: Other shape or dtype, an empty picture, or values that are not finite.
    """
    if hasattr(image, "detach"):  # a torch tensor, handled without importing torch
        image = image.detach().cpu().numpy()
    image = np.asarray(image)
    if image.ndim != 3 or image.shape[2] != 3 or image.size == 0:
        raise ShapeError(f"{name} must be [H, W, 3], got {list(image.shape)}.")
    if image.dtype == np.uint8:
        return image / 255.0
    if not np.issubdtype(image.dtype, np.floating):
        raise ShapeError(f"{name} must be floating point or uint8, got {image.dtype}.")
    if not np.isfinite(image).all():
        bad = int((~np.isfinite(image)).sum())
        raise ShapeError(f"{name} has {bad} values that are not finite; it cannot be measured.")
    return np.clip(image.astype(np.float64), 0.0, 1.0)


def _pair(image: Any, target: Any) -> tuple[np.ndarray, np.ndarray]:
    a, b = as_float("image", image), as_float("target", target)
    if a.shape != b.shape:
        raise ShapeError(
            f"image and target must have the same size, got {list(a.shape)} and {list(b.shape)}."
        )
    return a, b


def _decibels(mse: float) -> float:
    return math.inf if mse == 0 else -10.0 * math.log10(mse)


def _to_levels(image: np.ndarray) -> np.ndarray:
    return np.floor(image * 255.0 + 0.5) / 255.0


def psnr(image: Any, target: Any, *, mask: np.ndarray | None = None) -> float:
    """Peak signal-to-noise ratio in dB of [H, W, 3] pictures clamped to [0, 1]; inf if equal.

    `mask`, [H, W] float in [0, 1] or uint8, weights the errors; NaN if all weights are 0.
    """
    a, b = _pair(image, target)
    if mask is None:
        return _decibels(float(np.mean((a - b) ** 2)))
    mse = _masked_mse(a, b, _mask_weight(mask, a.shape))
    return math.nan if mse is None else _decibels(mse)


def psnr_u8(image: Any, target: Any) -> float:
    """PSNR in dB after rounding both pictures to 8 bit, equal to that of saved PNG files."""
    a, b = _pair(image, target)
    return _decibels(float(np.mean((_to_levels(a) - _to_levels(b)) ** 2)))


def psnr_cc(image: Any, target: Any, *, mask: np.ndarray | None = None) -> float:
    """PSNR in dB after colour correction, independent of exposure and white balance.

    Per channel, a gain >= 0 and an offset are fitted by least squares on the left half of the
    picture and evaluated on the right half, and vice versa. Unless values are clipped, a gain and
    offset of the image do not change the result. It can be below `psnr`, because the fit of one
    half may not suit the other.

    Args:
        image, target: [H, W, 3] float in [0, 1] or uint8.
        mask: [H, W] float in [0, 1] or uint8: weights of fit, error and halves, or None.

    Returns:
        dB; inf if only gain and offset differ; NaN if one half is completely masked.
    """
    a, b = _pair(image, target)
    weight = None if mask is None else _mask_weight(mask, a.shape)[:, :, 0]
    mse = corrected_mse(_planar(a), _planar(b), weight)
    return math.nan if mse is None else _decibels(mse)


def colour_corrected(image: Any, target: Any, *, mask: np.ndarray | None = None) -> np.ndarray:
    """The picture with the colours of the target, for metrics of structure: a gain >= 0 and an
    offset per channel, fitted by least squares, clamped to [0, 1].

    One fit to the whole picture, because a seam between halves, as in `psnr_cc`, would count as
    structure; SSIM and LPIPS respond little to such a fit anyway.

    Args:
        image, target: [H, W, 3] float in [0, 1] or uint8.
        mask: [H, W] float in [0, 1] or uint8: weights of the fit, or None.

    Returns:
        [H, W, 3] float64; `image` if all weights are 0.
    """
    a, b = _pair(image, target)
    return _corrected(a, b, None if mask is None else _mask_weight(mask, a.shape))


def _corrected(a: np.ndarray, b: np.ndarray, weight: np.ndarray | None) -> np.ndarray:
    if weight is not None and not weight.any():
        return a
    weights = None if weight is None else weight[:, :, 0]
    gain, offset = fit_colours(_planar(a), _planar(b), weights)
    return np.clip(a * gain + offset, 0.0, 1.0)


def _gaussian_window() -> np.ndarray:
    offsets = np.arange(SSIM_WINDOW) - SSIM_WINDOW // 2
    window = np.exp(-(offsets**2) / (2 * SSIM_SIGMA**2))
    return window / window.sum()


def _blur(planes: np.ndarray) -> np.ndarray:
    """Gaussian filter over the last two axes, zero padded, float64."""
    correlate1d = need("scipy.ndimage", "SSIM").correlate1d
    window = _gaussian_window()
    rows = correlate1d(planes, window, axis=-2, mode="constant")
    return correlate1d(rows, window, axis=-1, mode="constant", output=rows)


def _ssim_terms(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Luminance and contrast-structure maps of two planar pictures, zero padded.

    The interior, `SSIM_WINDOW // 2` pixels from every side, equals the valid convolution, so one
    call computes both conventions and the finest scale of MS-SSIM.

    Args:
        a, b: [3, H, W] float64 in [0, 1].

    Returns:
        [3, H, W] luminance, [3, H, W] contrast times structure (Wang et al. 2004, eq. 6 and 13).
    """
    luminance, contrast = np.empty_like(a), np.empty_like(a)
    for k, (x, y) in enumerate(zip(a, b, strict=True)):  # one at a time, to save memory
        # Only the sum of the variances is needed, so four pictures are blurred instead of five.
        mu_x, mu_y, square, product = (_blur(p) for p in (x, y, x * x + y * y, x * y))
        mu_xy = mu_x * mu_y
        mu_square = mu_x * mu_x
        mu_square += mu_y * mu_y
        contrast[k] = (2 * (product - mu_xy) + SSIM_C2) / (square - mu_square + SSIM_C2)
        luminance[k] = (2 * mu_xy + SSIM_C1) / (mu_square + SSIM_C1)
    return luminance, contrast


def _planar(image: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(image.transpose(2, 0, 1))


def _inside(planes: np.ndarray) -> np.ndarray:
    edge = SSIM_WINDOW // 2
    return planes[..., edge:-edge, edge:-edge]


def _halve(planes: np.ndarray) -> np.ndarray:
    """Mean of 2 x 2 pixels; the last row or column of an odd size is repeated (Wang's code)."""
    height, width = planes.shape[-2:]
    if height % 2 or width % 2:
        planes = np.pad(planes, ((0, 0), (0, height % 2), (0, width % 2)), mode="edge")
    rows = planes[:, 0::2] + planes[:, 1::2]
    return (rows[:, :, 0::2] + rows[:, :, 1::2]) * 0.25


def _check_fits(image: np.ndarray, side: int, what: str) -> None:
    if min(image.shape[:2]) < side:
        height, width = image.shape[:2]
        raise ShapeError(
            f"{what} needs pictures of at least {side} x {side} pixels, got {width} x {height}."
        )


def ssim(image: Any, target: Any, *, padding: Literal["zero", "valid"] = "zero") -> float:
    """Structural similarity, 11 x 11 Gaussian window of sigma 1.5, mean over pixels and channels.

    Args:
        image, target: [H, W, 3] float in [0, 1] or uint8.
        padding: `zero`: zero padding, as in the 3DGS code and the loss; `valid`: only windows
            inside the picture count.

    Raises:
        ShapeError: Sizes differ, or `valid` with a side shorter than the window.
    """
    a, b = _pair(image, target)
    if padding == "valid":
        _check_fits(a, SSIM_WINDOW, "ssim with padding 'valid'")
    luminance, contrast = _ssim_terms(_planar(a), _planar(b))
    values = luminance * contrast
    return float(np.mean(_inside(values) if padding == "valid" else values))


def d_ssim(image: Any, target: Any) -> float:
    """Structural dissimilarity (1 - ssim) / 2 of the zero-padded SSIM, in [0, 1]."""
    return (1.0 - ssim(image, target)) / 2.0


def ms_ssim(image: Any, target: Any) -> float:
    """Multi-scale SSIM over five scales with valid windows, mean over the channels.

    Wang, Simoncelli, Bovik 2003, eq. 7: contrast-structure means of the four finer scales and the
    SSIM of the coarsest, to the powers `MS_WEIGHTS`. Negative means, which have no real power,
    count as 0.

    Args:
        image, target: [H, W, 3] float in [0, 1] or uint8, both sides at least 161 px.

    Raises:
        ShapeError: Sizes differ or a side is shorter than 161 px; fewer scales would be another
            metric.
    """
    a, b = _pair(image, target)
    _check_fits(a, MS_SMALLEST, "ms_ssim")
    a, b = _planar(a), _planar(b)
    return _ms_ssim(a, b, *_ssim_terms(a, b))


def _ms_ssim(a: np.ndarray, b: np.ndarray, luminance: np.ndarray, contrast: np.ndarray) -> float:
    """MS-SSIM of [3, H, W] pictures from their terms at the finest scale."""
    product = np.ones(3)
    for scale, weight in enumerate(MS_WEIGHTS):
        if scale > 0:
            a, b = _halve(a), _halve(b)
            luminance, contrast = _ssim_terms(a, b)
        last = scale == len(MS_WEIGHTS) - 1
        values = _inside(contrast * luminance if last else contrast)
        product *= np.maximum(values.mean(axis=(1, 2)), 0.0) ** weight
    return float(product.mean())


def image_metrics(image: Any, target: Any, *, mask: np.ndarray | None = None) -> dict[str, Any]:
    """All metrics of a pair except LPIPS, sharing one filtering of the pictures.

    Args:
        image, target: [H, W, 3] float in [0, 1] or uint8.
        mask: [H, W] float in [0, 1] or uint8, or None. Both pictures are multiplied by it, as in
            the loss, and `psnr_masked` is added: the error weighted by the mask, so masked pixels
            do not count as perfect.

    Returns:
        psnr, psnr_u8, psnr_cc (of unmasked pixels, see `psnr_cc`), ssim, ssim_cc (of the picture
        of `colour_corrected`), ssim_valid, d_ssim, ms_ssim and, with a mask, psnr_masked. A missing
        value is None, with its reason in `<key>_reason`.

    Raises:
        ShapeError: Sizes differ or values are not finite.
    """
    a, b = _pair(image, target)
    values: dict[str, Any] = {}
    _put_psnr_cc(values, a, b, mask)
    weight = None if mask is None else _mask_weight(mask, a.shape)
    corrected = _corrected(a, b, weight)
    if weight is not None:
        _put_psnr(values, "psnr_masked", _masked_mse(a, b, weight))
        a, b, corrected = a * weight, b * weight, corrected * weight
    _put_psnr(values, "psnr", float(np.mean((a - b) ** 2)))
    _put_psnr(values, "psnr_u8", float(np.mean((_to_levels(a) - _to_levels(b)) ** 2)))
    corrected, a, b = _planar(corrected), _planar(a), _planar(b)
    luminance, contrast = _ssim_terms(a, b)
    similarity = luminance * contrast
    values["ssim"] = float(similarity.mean())
    values["ssim_cc"] = float(np.multiply(*_ssim_terms(corrected, b)).mean())
    values["d_ssim"] = (1.0 - values["ssim"]) / 2.0
    side = min(a.shape[1:])
    size = f"the picture is {a.shape[2]} x {a.shape[1]} pixels"
    if side >= SSIM_WINDOW:
        values["ssim_valid"] = float(_inside(similarity).mean())
    else:
        values["ssim_valid"] = None
        values["ssim_valid_reason"] = f"needs {SSIM_WINDOW} x {SSIM_WINDOW} pixels, {size}"
    if side >= MS_SMALLEST:
        values["ms_ssim"] = _ms_ssim(a, b, luminance, contrast)
    else:
        values["ms_ssim"] = None
        values["ms_ssim_reason"] = f"needs {MS_SMALLEST} x {MS_SMALLEST} pixels, {size}"
    return values


def _mask_weight(mask: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """[H, W, 1] float64 weights of a mask for a picture of this shape."""
    mask = np.asarray(mask)
    if mask.shape != shape[:2]:
        raise ShapeError(f"mask must be {list(shape[:2])}, got {list(mask.shape)}.")
    scale = 255.0 if mask.dtype == np.uint8 else 1.0
    return mask.astype(np.float64)[:, :, None] / scale


def _masked_mse(a: np.ndarray, b: np.ndarray, weight: np.ndarray) -> float | None:
    """Mean squared error weighted by [H, W, 1]; None if all weights are zero."""
    total = 3 * float(weight.sum())
    return float((weight * (a - b) ** 2).sum()) / total if total > 0 else None


def _put_psnr(values: dict[str, Any], key: str, mse: float | None) -> None:
    """Store the PSNR of a mean squared error; infinity becomes None, for JSON."""
    if mse is None:
        values[key], values[key + "_reason"] = None, EMPTY_MASK
    elif mse == 0:
        values[key], values[key + "_reason"] = None, "infinite: the pictures are identical"
    else:
        values[key] = _decibels(mse)


def _put_psnr_cc(
    values: dict[str, Any], a: np.ndarray, b: np.ndarray, mask: np.ndarray | None
) -> None:
    """Store the colour-corrected PSNR of [H, W, 3] pictures, or why there is none."""
    weight = None if mask is None else _mask_weight(mask, a.shape)[:, :, 0]
    mse = corrected_mse(_planar(a), _planar(b), weight)
    _put_psnr(values, "psnr_cc", mse)
    if mse is None and (weight is None or weight.any()):
        values["psnr_cc_reason"] = "one column of pixels has no halves"
    elif mse == 0:
        values["psnr_cc_reason"] = "infinite: at most gain and offset of the colours differ"
