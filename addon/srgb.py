"""sRGB conversion to and from linear light; no bpy."""

import numpy as np

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Weights of linear Rec. 709 (ITU-R BT.709, section 3)."""


def decode(values: np.ndarray) -> np.ndarray:
    """Linear light of sRGB values (IEC 61966-2-1), float32; values above 1 continue the curve."""
    values = np.maximum(np.asarray(values, np.float32), np.float32(0))
    curve = ((values + np.float32(0.055)) * np.float32(1 / 1.055)) ** np.float32(2.4)
    return np.where(values <= np.float32(0.04045), values * np.float32(1 / 12.92), curve)


def encode(light: np.ndarray) -> np.ndarray:
    """The inverse of `decode`."""
    light = np.maximum(np.asarray(light, np.float32), np.float32(0))
    curve = np.float32(1.055) * light ** np.float32(1 / 2.4) - np.float32(0.055)
    return np.where(light <= np.float32(0.0031308), light * np.float32(12.92), curve)
