"""Error map: splats coloured by their error, as a model for any viewer."""

from dataclasses import replace

import numpy as np

from ..sh import rgb_to_sh0
from ..splats import Splats
from .colormap import colorize

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
