"""Premultiplied alpha for resampling pictures, and its inverse."""

import numpy as np

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
