"""Photo quality: sharpness and brightness, blurred photos, exposure jumps."""

from dataclasses import dataclass
from typing import Any

import numpy as np

_SIDE = 1600
"""Longer side, px, of the measured photos, similar to that of training and features."""
_BLURRED = 0.4
"""Detail relative to the median photo below which a photo is blurred."""
_JUMP = 1.0
"""Difference of an exposure jump from both neighbours and from the median, stops."""
_DARK = 1e-4


@dataclass(frozen=True)
class PhotoQuality:
    """Sharpness and brightness of one photo."""

    detail: float
    """Energy of second differences against that of first ones, along the axis where it is less:
    blur takes the former away and leaves the latter, contrast changes both."""
    light: float
    """Mean linear brightness, stops."""


def measure_quality(image: Any) -> PhotoQuality:
    """Measure a decoded photo of Pillow."""
    grey = image.convert("L")
    grey.thumbnail((_SIDE, _SIDE))
    pixels = np.asarray(grey, np.float32) / 255
    detail = min(_detail(pixels), _detail(pixels.T))
    return PhotoQuality(detail, float(np.log2((pixels**2.2).mean() + _DARK)))


def _detail(pixels: np.ndarray) -> float:
    first = np.diff(pixels, axis=1)
    second = np.diff(first, axis=1)
    energy = float((first**2).sum())
    return float((second**2).sum()) / energy if energy > 0 else 0.0


def blurred(looks: list[PhotoQuality]) -> list[int]:
    """Indices of photos with much less detail than the others."""
    if not looks:
        return []
    usual = float(np.median([look.detail for look in looks]))
    return [i for i, look in enumerate(looks) if look.detail < _BLURRED * usual]


def exposure_jumps(looks: list[PhotoQuality]) -> list[int]:
    """Indices of photos much brighter or darker than both neighbours and the median."""
    light = np.array([look.light for look in looks])
    if len(light) < 3:
        return []
    before, after = np.roll(light, 1), np.roll(light, -1)
    before[0], after[-1] = after[0], before[-1]
    off = np.min(np.abs([light - before, light - after, light - np.median(light)]), axis=0)
    return np.flatnonzero(off > _JUMP).tolist()
