"""Photo quality: sharpness and brightness, blurred photos, exposure jumps."""

from dataclasses import dataclass
from typing import Any

import numpy as np

_SIDE = 1600
"""Longer side of the measured photos, px, similar to that of training and features."""
_BLURRED = 0.4
"""Detail relative to the median photo below which a photo is blurred."""
_JUMP = 1.0
"""Minimum difference from both neighbours and from the median in an exposure jump, stops."""
_DARK = 1e-4


@dataclass(frozen=True)
class PhotoQuality:
    """Sharpness and brightness of one photo."""

    detail: float
    """Energy of second differences relative to first ones, minimum of both axes: blur reduces the
    former more than the latter, contrast scales both."""
    light: float
    """Mean linear brightness, stops."""


def measure_quality(image: Any) -> PhotoQuality:
    """Measure Pillow's decoded image."""
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


def blurred(qualities: list[PhotoQuality]) -> list[int]:
    """Indices of photos with much less detail than the others."""
    if not qualities:
        return []
    median = float(np.median([quality.detail for quality in qualities]))
    return [i for i, quality in enumerate(qualities) if quality.detail < _BLURRED * median]


def exposure_jumps(qualities: list[PhotoQuality]) -> list[int]:
    """Indices of photos much brighter or darker than both neighbours and the median."""
    light = np.array([quality.light for quality in qualities])
    if len(light) < 3:
        return []
    before, after = np.roll(light, 1), np.roll(light, -1)
    before[0], after[-1] = after[0], before[-1]
    off = np.min(np.abs([light - before, light - after, light - np.median(light)]), axis=0)
    return np.flatnonzero(off > _JUMP).tolist()
