"""Colormap of errors, black over blue, magenta and orange to pale yellow; splats coloured by it."""

from dataclasses import replace

import numpy as np

from ..io.images.pixels import as_uint8
from ..sh import rgb_to_sh0
from ..splats import Splats

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
    return _TABLE[as_uint8(values)]


def _table() -> np.ndarray:
    at = np.linspace(0.0, 1.0, len(_STOPS))
    channels = [np.interp(np.linspace(0.0, 1.0, 256), at, _STOPS[:, c]) for c in range(3)]
    return np.stack(channels, axis=1).round().astype(np.uint8)


_TABLE = _table()
"""[256, 3] uint8."""


_BRIGHT_SHARE = 0.95
"""Quantile of the errors that has the brightest colour."""
_UNSEEN = 0.35
"""Grey, sRGB, of splats without an error."""


def brightest(errors: np.ndarray) -> float:
    """The smallest error with the brightest colour; above 0.

    Args:
        errors: [N] float, NaN: unknown.
    """
    known = errors[np.isfinite(errors)]
    return max(float(np.quantile(known, _BRIGHT_SHARE)), 1e-3) if len(known) else 1.0


def error_map(splats: Splats, errors: np.ndarray, *, bright: float) -> Splats:
    """The splats coloured by their errors, from black for 0 to pale yellow for `bright` and more,
    grey for unknown errors; without view-dependent colour.

    Args:
        splats: N splats.
        errors: [N] float, NaN: unknown.
        bright: Result of `brightest`.
    """
    known = np.isfinite(errors)
    rgb = np.full((len(splats), 3), _UNSEEN)
    rgb[known] = colorize(errors[known] / bright) / 255.0
    return replace(
        splats,
        sh0=rgb_to_sh0(rgb[:, None]).astype(np.float32),
        shN=np.zeros((len(splats), 0, 3), np.float32),
    )
