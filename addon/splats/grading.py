"""Colour grading of splats: lift, gamma, gain, saturation; no bpy."""

from dataclasses import dataclass

import numpy as np

from ..core import rgb_to_sh0, sh0_to_rgb

_LUMA = np.array([0.2126, 0.7152, 0.0722])
"""Luma weights of Rec. 709."""
_BLOCK = 1 << 14
"""Splats per block, so that intermediate results stay in the cache."""


@dataclass(frozen=True, kw_only=True)
class Grade:
    """Grading operations in this order on sRGB values; three values are per channel."""

    lift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """New value of black; white stays."""
    gamma: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Above 1 brightens the midtones; black and white stay."""
    gain: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """New value of white; black stays."""
    saturation: float = 1.0
    """0 for grey."""


def graded(base: np.ndarray, grade: Grade) -> np.ndarray:
    """[N, 4] float32: graded `radiance:base` [N, 4], bit-identical for a neutral grade.

    View-dependent coefficients stay unchanged; values below 0, which they may raise again, keep
    their sign.
    """
    out = base.copy()
    if grade != Grade():
        for at in range(0, len(base), _BLOCK):
            out[at : at + _BLOCK, :3] = _colors(base[at : at + _BLOCK, :3], grade)
    return out


def _colors(sh0: np.ndarray, grade: Grade) -> np.ndarray:
    """[K, 3] float64 coefficients of colours [K, 3]."""
    colors = sh0_to_rgb(sh0.astype(np.float64))
    lift, gamma, gain = (np.array(v) for v in (grade.lift, grade.gamma, grade.gain))
    colors = lift + colors * (1 - lift)
    if (gamma != 1).any():
        colors = np.sign(colors) * np.abs(colors) ** (1 / gamma)
    colors *= gain
    grey = (colors @ _LUMA)[:, None]
    return rgb_to_sh0(grey + (colors - grey) * grade.saturation)
