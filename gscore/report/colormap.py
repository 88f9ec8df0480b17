"""Colormap of error pictures: black over blue, magenta and orange to pale yellow."""

import numpy as np

# sRGB at equal steps; lightness increases evenly, so that the map also works in grey.
_STOPS = np.array(
    [
        [0, 0, 4],
        [24, 15, 60],
        [66, 20, 110],
        [114, 26, 118],
        [163, 40, 104],
        [208, 62, 76],
        [240, 104, 44],
        [252, 158, 32],
        [248, 212, 84],
        [252, 253, 204],
    ],
    dtype=np.float64,
)


def colorize(values: np.ndarray) -> np.ndarray:
    """Colours of values in [0, 1], which are clamped.

    Args:
        values: [...] float.

    Returns:
        [..., 3] uint8 sRGB.
    """
    return _TABLE[(np.clip(values, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)]


def _table() -> np.ndarray:
    at = np.linspace(0.0, 1.0, len(_STOPS))
    channels = [np.interp(np.linspace(0.0, 1.0, 256), at, _STOPS[:, c]) for c in range(3)]
    return np.stack(channels, axis=1).round().astype(np.uint8)


_TABLE = _table()
"""[256, 3] uint8."""
