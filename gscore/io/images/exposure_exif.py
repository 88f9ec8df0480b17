"""EXIF exposure of a photo: shutter time, aperture and sensitivity."""

import math
from pathlib import Path
from typing import Any

from .pillow_images import opened_picture

_EXIF, _TIME, _APERTURE, _SPEED = 0x8769, 0x829A, 0x829D, 0x8827
"""Tags: Exif directory, exposure time in s, f-number, ISO speed."""


def stated_exposure(path: Path) -> float | None:
    """log2(time x ISO / f-number^2): brightness of the same scene in stops above an exposure of 1 s
    at ISO 1, f/1. None if EXIF lacks one of the three.

    Raises:
        DatasetError, FormatError, BackendError: as `read_info`.
    """
    with opened_picture(path) as image:
        time, aperture, speed = _stated(image)
    value = time * speed / aperture**2 if aperture > 0 else 0.0
    return math.log2(value) if 0 < value < math.inf else None


def _stated(image: Any) -> tuple[float, float, float]:
    """Time, f-number and speed; 0 for missing ones."""
    try:
        tags = image.getexif().get_ifd(_EXIF)
        return _number(tags.get(_TIME)), _number(tags.get(_APERTURE)), _number(tags.get(_SPEED))
    except Exception:  # damaged EXIF does not make the picture unusable
        return 0.0, 0.0, 0.0


def _number(value: Any) -> float:
    """EXIF value as a number, the first of several; 0 if it is none."""
    if isinstance(value, tuple | list):
        value = value[0] if value else 0
    try:
        return float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return 0.0
