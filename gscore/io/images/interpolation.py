"""Image lookup at fractional pixels, bilinear or cubic; numpy only."""

import numpy as np

_TAPS = (-1, 0, 1, 2)
"""Taps of cubic convolution along an axis, relative to the pixel before the position."""


class Pixels:
    """A picture, [h, w] or [h, w, D] of any dtype, for interpolation at many positions."""

    def __init__(self, image: np.ndarray) -> None:
        self._shape = image.shape[:2]
        self._flat = _packed(image)

    def bilinear(self, x: np.ndarray, y: np.ndarray, out: np.ndarray) -> None:
        """Fill `out` [r, W, ...], of the picture's dtype.

        Args:
            x: [r, W] columns, 0 to w - 1.
            y: [r, W] rows, 0 to h - 1.
            out: Receives the interpolated values.
        """
        height, width = self._shape
        left = np.minimum(x.astype(np.int64), max(width - 2, 0))
        top = np.minimum(y.astype(np.int64), max(height - 2, 0))
        fx, fy = (x - left).astype(np.float32), (y - top).astype(np.float32)
        at = top * width + left
        right, below = (1 if width > 1 else 0), (width if height > 1 else 0)
        corners = [_unpacked(self._flat[at + k], out) for k in (0, right, below, right + below)]
        channels = range(out.shape[2]) if out.ndim == 3 else [...]
        for c in channels:
            key = (..., c) if out.ndim == 3 else ...
            a, b, d, e = (corner[key].astype(np.float32) for corner in corners)
            a += fx * (b - a)
            d += fx * (e - d)
            a += fy * (d - a)
            out[key] = np.rint(a) if out.dtype.kind in "iu" else a

    def cubic(self, x: np.ndarray, y: np.ndarray, out: np.ndarray) -> None:
        """Like `bilinear`, for uint8, by cubic convolution (Keys 1981, with a = -1/2). Pixels at
        the border are repeated outwards."""
        height, width = self._shape
        left, top = x.astype(np.int64), y.astype(np.int64)
        across, down = _keys((x - left).astype(np.float32)), _keys((y - top).astype(np.float32))
        columns = [np.clip(left + k, 0, width - 1) for k in _TAPS]
        channels = range(out.shape[2]) if out.ndim == 3 else [...]
        sums = [np.zeros(x.shape, np.float32) for _ in channels]
        for k, weight_down in zip(_TAPS, down, strict=True):
            rows = np.clip(top + k, 0, height - 1) * width
            for column, weight_across in zip(columns, across, strict=True):
                pixels = _unpacked(self._flat[rows + column], out)
                weight = weight_down * weight_across
                for total, c in zip(sums, channels, strict=True):
                    total += weight * (pixels if c is ... else pixels[..., c])
        for total, c in zip(sums, channels, strict=True):
            np.clip(np.rint(total, out=total), 0, 255, out=total)
            out[... if c is ... else (..., c)] = total


def _keys(t: np.ndarray) -> tuple[np.ndarray, ...]:
    """Weights of the pixels at `_TAPS` for a position `t`, 0 to 1, after a pixel."""
    s = 1 - t
    return (
        -0.5 * t * s * s,
        1 + t * t * (1.5 * t - 2.5),
        1 + s * s * (1.5 * s - 2.5),
        -0.5 * s * t * t,
    )


def _packed(image: np.ndarray) -> np.ndarray:
    """[h w, ...] rows; uint8 colours packed into uint32, which gathers several times faster."""
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] not in (3, 4):
        return image.reshape(-1, *image.shape[2:])
    if image.shape[2] == 3:
        image = np.concatenate([image, np.zeros_like(image[..., :1])], axis=2)
    return np.ascontiguousarray(image).view(np.uint32).reshape(-1)


def _unpacked(values: np.ndarray, out: np.ndarray) -> np.ndarray:
    """Undo `_packed` for gathered values [r, W] or [r, W, ...]."""
    if values.ndim == out.ndim:
        return values
    return np.ascontiguousarray(values).view(np.uint8).reshape(*values.shape, 4)
