"""Error map: splats coloured by their error, as a model for any viewer."""

from dataclasses import replace

import numpy as np

from ..sh import rgb_to_sh0
from ..splats import Splats
from .colormap import colorize

_BRIGHT_SHARE = 0.95
"""Share of the splats with an error that are not yet of the brightest colour."""
_UNSEEN = 0.35
"""Grey, sRGB, of splats without an error."""


def brightest(errors: np.ndarray) -> float:
    """The error from which on splats have the brightest colour; above 0.

    Args:
        errors: [N] float, NaN where there is none.
    """
    known = errors[np.isfinite(errors)]
    return max(float(np.quantile(known, _BRIGHT_SHARE)), 1e-3) if len(known) else 1.0


def error_map(splats: Splats, errors: np.ndarray, *, bright: float) -> Splats:
    """The splats in the colours of their errors, from black for none to pale yellow for `bright`
    and more; grey where there is none. The same from everywhere.

    Args:
        splats: N of them.
        errors: [N] float, NaN where there is none.
        bright: As `brightest` finds it.
    """
    known = np.isfinite(errors)
    rgb = np.full((len(splats), 3), _UNSEEN)
    rgb[known] = colorize(errors[known] / bright) / 255.0
    return replace(
        splats,
        sh0=rgb_to_sh0(rgb[:, None]).astype(np.float32),
        shN=np.zeros((len(splats), 0, 3), np.float32),
    )
