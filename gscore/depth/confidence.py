"""Confidence of the pixels of a depth map, 0 at unknown, masked and edge pixels."""

import numpy as np

_STEP_SHARE = 0.01
"""Bend of a map, relative to its spread, at which a pixel counts half."""


def confidence(values: np.ndarray, mask: np.ndarray | None) -> np.ndarray:
    """Trust in the pixels of a map that is affine in inverse depth.

    Inverse depth is affine across a plane whatever its slant, so its second differences show edges
    between surfaces and nothing else, at any scale and offset of the map.

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
    """[H, W] float32 trust in the pixels of a map [H, W] float32, NaN: unknown, by its bends alone.

    0.5 where a second difference there or beside it is `half`, [H, W] or one number; 0 next to
    unknown ones.
    """
    bend = _spread_by_one(_bend(values))
    out = 1.0 / (1.0 + (bend / half) ** 2)
    out[~(np.isfinite(values) & np.isfinite(bend))] = 0
    return out


def shown_by(mask: np.ndarray, trust: np.ndarray) -> np.ndarray:
    """[H, W] float32 trust in the pixels that a mask [H, W] uint8 shows, without its rim."""
    return (trust * _eroded(mask.astype(np.float32) / 255)).astype(np.float32)


def _bend(values: np.ndarray) -> np.ndarray:
    """[H, W] larger magnitude of the two second differences; 0 at borders, NaN next to unknown."""
    out = np.zeros_like(values)
    inner = out[:, 1:-1]
    np.abs(values[:, 2:] - 2 * values[:, 1:-1] + values[:, :-2], out=inner)
    down = np.abs(values[2:] - 2 * values[1:-1] + values[:-2])
    out[1:-1] = np.maximum(out[1:-1], down)
    return out


def _spread_by_one(values: np.ndarray) -> np.ndarray:
    """Maximum over 3 x 3 pixels; NaN if there is one."""
    return -_lowest(-values)


def _eroded(values: np.ndarray) -> np.ndarray:
    """Minimum over 3 x 3 pixels: the rim of a mask mixes what is in front with what is behind."""
    return _lowest(values)


def _lowest(values: np.ndarray) -> np.ndarray:
    out = values.copy()
    out[1:] = np.minimum(out[1:], values[:-1])
    out[:-1] = np.minimum(out[:-1], values[1:])
    wide = out.copy()
    wide[:, 1:] = np.minimum(wide[:, 1:], out[:, :-1])
    wide[:, :-1] = np.minimum(wide[:, :-1], out[:, 1:])
    return wide
