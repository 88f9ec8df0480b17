"""sRGB values and linear light (IEC 61966-2-1) in float64, and photos under another exposure."""

import numpy as np
from numpy.typing import ArrayLike


def decode(encoded: ArrayLike) -> np.ndarray:
    """Linear light of sRGB values from 0."""
    encoded = np.asarray(encoded, np.float64)
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def encode(light: ArrayLike) -> np.ndarray:
    """sRGB values of linear light."""
    light = np.asarray(light, np.float64)
    high = 1.055 * np.maximum(light, 0.0031308) ** (1 / 2.4) - 0.055
    return np.where(light <= 0.0031308, 12.92 * light, high)


def exposed_by(values: np.ndarray, gain: np.ndarray | float) -> np.ndarray:
    """sRGB values of light times gain^2.4."""
    return encode(decode(values) * np.asarray(gain) ** 2.4)


def exposed_bytes(image: np.ndarray, gain: np.ndarray | float) -> np.ndarray:
    """Image of uint8 exposed by a gain, clipped."""
    return np.clip(255 * exposed_by(image / 255, gain) + 0.5, 0, 255).astype(np.uint8)
