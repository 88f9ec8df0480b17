"""Limits of opacity and size: splats that are opaque enough, neither too small nor too large."""

import numpy as np


def at_least_opaque(opacities: np.ndarray, least: float) -> np.ndarray:
    """Mask [N] bool of the opacities [N], in [0, 1], of at least `least`."""
    return opacities >= np.float32(least)


def of_size(scales: np.ndarray, least: float = 0.0, most: float = 0.0) -> np.ndarray:
    """Mask [N] bool of the splats with a size between two inclusive limits.

    Args:
        scales: [N, 3] standard deviations, not their logs; the largest of a splat is its size.
        least: Least size, world units.
        most: Largest size, world units; 0: no limit.
    """
    sizes = scales.max(axis=1, initial=-np.inf)
    keep = sizes >= np.float32(least)
    return keep & (sizes <= np.float32(most)) if most > 0 else keep
