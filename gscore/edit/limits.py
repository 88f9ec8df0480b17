"""Limits of opacity and size: splats that are opaque enough, neither too small nor too large."""

import numpy as np


def at_least_opaque(opacities: np.ndarray, least: float) -> np.ndarray:
    """[N] bool: opacities [N] in [0, 1] of at least `least`."""
    return opacities >= np.float32(least)


def of_size(scales: np.ndarray, least: float = 0.0, most: float = 0.0) -> np.ndarray:
    """[N] bool: which splats have a size between two limits, which belong to it.

    Args:
        scales: [N, 3] standard deviations, not their logs; the largest of a splat is its size.
        least: World units, as the scales.
        most: The same; 0: no limit.
    """
    sizes = scales.max(axis=1, initial=-np.inf)
    keep = sizes >= np.float32(least)
    return keep & (sizes <= np.float32(most)) if most > 0 else keep
