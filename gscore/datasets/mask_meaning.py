"""Mask meaning: mattes of a subject, or pixels to ignore."""

from collections import Counter
from collections.abc import Callable

import numpy as np

_SAMPLED = 12
"""Most masks that are read, spread over the views."""
_KEPT = 0.7
"""Share of the photo that a subject covers at most."""
_KEPT_RIM = 0.25
"""Share of the rim that it covers at most, because a matte hides the surroundings."""
_RIM = 0.02
"""Width of the rim, as a share of the shorter side."""


def are_mattes(count: int, mask: Callable[[int], np.ndarray]) -> bool:
    """True if masks cut a subject out of its surroundings.

    Such masks hide most of the rim of most photos. Masks of passers-by, a tripod or the sky keep
    most of it; masks of a lens are equal for most photos.

    Args:
        count: Number of masks, at least one.
        mask: Returns mask i, [H, W] uint8, 255 = keep; called for some of them. Its errors are
            passed on.
    """
    sample = [mask(i) for i in range(0, count, -(-count // _SAMPLED))]
    most_equal = max(Counter(each.tobytes() for each in sample).values())
    if most_equal > max(len(sample) / 2, 1):
        return False
    kept = np.median([each.mean() for each in sample]) / 255
    rim = np.median([_rim(each).mean() for each in sample]) / 255
    return bool(kept < _KEPT and rim < _KEPT_RIM)


def _rim(mask: np.ndarray) -> np.ndarray:
    """Pixels near the border of `mask` [H, W], flattened."""
    width = max(round(_RIM * min(mask.shape)), 1)
    inside = mask[width:-width]
    sides = (mask[:width], mask[-width:], inside[:, :width], inside[:, -width:])
    return np.concatenate([side.ravel() for side in sides])
