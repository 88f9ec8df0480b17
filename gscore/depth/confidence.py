"""Confidence of the pixels of a depth map, 0 at unknown, masked and edge pixels."""

import numpy as np

_STEP_SHARE = 0.01
"""Second difference of a map, relative to its spread, at which the confidence is 0.5."""


def confidence(values: np.ndarray, mask: np.ndarray | None) -> np.ndarray:
    """Confidence in the pixels of a map that is affine in inverse depth.

    Inverse depth is affine across any plane, so its second differences show only edges between
    surfaces, at any scale and offset of the map.

    Args:
        values: [H, W] float32, NaN: unknown.
        mask: [H, W] uint8, 255 = keep, or None.

    Returns:
        [H, W] float32 in [0, 1].
    """
    known = np.isfinite(values)
    if not known.any():
        return np.zeros(values.shape, np.float32)
    low, high = np.quantile(values[known], (0.02, 0.98))
    out = inner(values, np.float32(_STEP_SHARE * max(float(high - low), 1e-30)))
    return out if mask is None else shown_by(mask, out)


def inner(values: np.ndarray, half: np.ndarray | np.float32) -> np.ndarray:
    """Confidence [H, W] float32 in the pixels of a map [H, W] float32, NaN: unknown, from its
    second differences only.

    0.5 where a second difference within 3 x 3 pixels is `half`, [H, W] or one number; 0 next to
    unknown ones.
    """
    difference = -_lowest(-_second_difference(values))  # the maximum over 3 x 3 pixels
    out = 1.0 / (1.0 + (difference / half) ** 2)
    out[~(np.isfinite(values) & np.isfinite(difference))] = 0
    return out


def shown_by(mask: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Confidence [H, W] float32 multiplied by a mask [H, W] uint8 without its rim."""
    # The rim of a mask mixes foreground and background.
    return (values * _lowest(mask.astype(np.float32) / 255)).astype(np.float32)


def _second_difference(values: np.ndarray) -> np.ndarray:
    """[H, W] larger magnitude of the two second differences; 0 at borders, NaN next to unknown."""
    out = np.zeros_like(values)
    inner = out[:, 1:-1]
    np.abs(values[:, 2:] - 2 * values[:, 1:-1] + values[:, :-2], out=inner)
    down = np.abs(values[2:] - 2 * values[1:-1] + values[:-2])
    out[1:-1] = np.maximum(out[1:-1], down)
    return out


def _lowest(values: np.ndarray) -> np.ndarray:
    """Minimum over 3 x 3 pixels; NaN if there is one."""
    out = values.copy()
    out[1:] = np.minimum(out[1:], values[:-1])
    out[:-1] = np.minimum(out[:-1], values[1:])
    wide = out.copy()
    wide[:, 1:] = np.minimum(wide[:, 1:], out[:, :-1])
    wide[:, :-1] = np.minimum(wide[:, :-1], out[:, 1:])
    return wide
