"""Training resolution of the photos, from the option `-r`."""

import math

import numpy as np

from ..errors import ConfigError

LARGEST_FACTOR = 8
"""Largest option that divides the size; larger ones are a width in pixels."""
SMALLEST_WIDTH = 16
"""Least width, pixels; a smaller one is assumed to be a mistake."""

_USUAL_WIDTH = 64
"""Width, pixels, below which a divisor was probably meant."""


def small_width_warnings(resolution: float, width: int, height: int) -> list[str]:
    """A sentence if the option `-r` is a very small width of pictures of this size, px."""
    if not LARGEST_FACTOR < resolution < _USUAL_WIDTH:
        return []
    return [
        f"Pictures are only {width} x {height} px: above {LARGEST_FACTOR} -r is their width in "
        "pixels, not a divisor."
    ]


def target_size(width: int, height: int, resolution: float, *, max_width: int) -> tuple[int, int]:
    """Size in pixels to scale a photo to, never larger than the photo.

    Args:
        width: Width of the undistorted photo, pixels.
        height: Height of the undistorted photo, pixels.
        resolution: -1: unscaled, but at most `max_width` wide; up to 8: divisor; larger: the width.
        max_width: Largest width for -1, pixels.

    Raises:
        ConfigError: `resolution` is none of these, or `max_width` is not positive.
    """
    check_resolution(resolution)
    if max_width < 1:
        raise ConfigError(f"max_width is {max_width}, expected a positive number of pixels.")
    if resolution == -1:
        factor = max(1.0, width / max_width)
    elif resolution <= LARGEST_FACTOR:
        factor = float(resolution)
    else:
        factor = max(1.0, width / resolution)
    return divided_size(width, height, factor)


def divided_size(width: int, height: int, factor: float) -> tuple[int, int]:
    """Size in pixels with the sides divided by `factor`, at least 1 x 1."""
    return max(1, round(width / factor)), max(1, round(height / factor))


def check_resolution(resolution: float) -> None:
    """Raise ConfigError unless `resolution` is valid for `target_size`."""
    factor = 1 <= resolution <= LARGEST_FACTOR
    pixels = SMALLEST_WIDTH <= resolution < math.inf
    if not (resolution == -1 or factor or pixels):
        raise ConfigError(
            f"resolution is {resolution:g}; expected -1 (as is, up to the preset's width), "
            f"1 to {LARGEST_FACTOR} (divide by it) or a width of at least {SMALLEST_WIDTH} px."
        )


def scale_intrinsics(
    K: np.ndarray, old_size: tuple[float, float], new_size: tuple[float, float]
) -> np.ndarray:
    """K of the same camera at another size in pixels, each axis scaled by its own ratio.

    Pixel centres are at +0.5, so positions scale without an offset: cx' = cx w' / w.

    Args:
        K: [3, 3] float64, pixels of the old size.
        old_size: Width and height, pixels.
        new_size: Width and height, pixels.

    Returns:
        [3, 3] float64, pixels of the new size.
    """
    ratio = np.array([new_size[0] / old_size[0], new_size[1] / old_size[1], 1.0])
    return K * ratio[:, None]
