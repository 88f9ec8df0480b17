"""Downscaling of photos in numpy, bit-identical to Pillow's, and premultiplied alpha."""

import numpy as np

from ...errors import ShapeError

_BITS = 22
"""Fraction bits of a weight, as in Pillow: 32 less 8 of a value and 2 of headroom."""


def downscale(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """Downscale an image by averaging.

    Integer factors use the mean of the pixels each new pixel covers, others a Hamming window of
    that size, first along rows, then along columns, rounded to bytes after each.

    Args:
        image: [H, W] or [H, W, 3] uint8.
        width: New width in pixels, at most the old one.
        height: New height in pixels, at most the old one.

    Returns:
        [height, width, ...] uint8.

    Raises:
        ShapeError: another shape or dtype, or a larger size.
    """
    old_height, old_width = image.shape[:2]
    fits = 0 < width <= old_width and 0 < height <= old_height
    if not fits or image.dtype != np.uint8 or image.ndim not in (2, 3) or image.shape[2:] == (4,):
        raise ShapeError(
            f"downscale takes uint8 images without alpha down to at least 1 x 1, got {image.dtype} "
            f"{list(image.shape)} to {width} x {height}."
        )
    if old_width % width == 0 and old_height % height == 0:
        return _block_means(image, old_width // width, old_height // height)
    if old_width != width:
        image = np.swapaxes(_resample_rows(np.swapaxes(image, 0, 1), width), 0, 1)
    if old_height != height:
        image = _resample_rows(image, height)
    return np.ascontiguousarray(image)


def _block_means(image: np.ndarray, across: int, down: int) -> np.ndarray:
    height, width = image.shape[0] // down, image.shape[1] // across
    blocks = image.reshape(height, down, width, across, *image.shape[2:])
    sums = blocks.sum(axis=(1, 3), dtype=np.uint64)
    count = np.uint64(across * down)
    reciprocal = np.uint64((1 << 24) // int(count))
    return ((sums + count // np.uint64(2)) * reciprocal >> np.uint64(24)).astype(np.uint8)


def _resample_rows(image: np.ndarray, count: int) -> np.ndarray:
    """[count, ...] uint8 from [H, ...]: each new row is a weighted sum of its neighbours."""
    scale = len(image) / count
    out = np.empty((count, *image.shape[1:]), np.uint8)
    for row in range(count):
        center = (row + 0.5) * scale
        first = max(0, int(center - scale + 0.5))
        last = min(len(image), int(center + scale + 0.5))
        weights = _hamming((np.arange(first, last) - center + 0.5) / scale)
        whole = np.floor(0.5 + weights / weights.sum() * (1 << _BITS)).astype(np.int64)
        total = np.tensordot(whole, image[first:last].astype(np.int64), axes=1)
        out[row] = np.clip(total + (1 << (_BITS - 1)) >> _BITS, 0, 255)
    return out


def _hamming(x: np.ndarray) -> np.ndarray:
    """Hamming-windowed sinc on (-1, 1), 0 outside."""
    return np.where(np.abs(x) < 1, np.sinc(x) * (0.54 + 0.46 * np.cos(np.pi * x)), 0.0)


_ROWS_A_STRIP = 64


def premultiplied(image: np.ndarray) -> np.ndarray:
    """[H, W, 3] uint8 colours times alpha, from RGBA [H, W, 4] uint8."""
    out = np.empty((*image.shape[:2], 3), np.uint8)
    for top in range(0, len(image), _ROWS_A_STRIP):
        strip = image[top : top + _ROWS_A_STRIP]
        alpha = strip[..., 3:].astype(np.uint16)
        out[top : top + _ROWS_A_STRIP] = (strip[..., :3] * alpha + 127) // 255
    return out


def divided(colors: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """RGBA [H, W, 4] uint8 with straight alpha, from premultiplied colours [H, W, 3] and alpha
    [H, W], both uint8."""
    weight = np.maximum(alpha, 1).astype(np.uint16)[..., None]
    rgb = (colors.astype(np.uint16) * 255 + weight // 2) // weight
    return np.dstack([np.minimum(rgb, 255).astype(np.uint8), alpha])
