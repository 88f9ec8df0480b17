"""Mask meaning: mattes of a subject, or pixels to ignore."""

from collections import Counter
from collections.abc import Callable

import numpy as np

_LOOKED_AT = 12
"""Masks that are read, spread over the views."""
_KEPT = 0.7
"""A subject covers less of its photo."""
_KEPT_RIM = 0.25
"""And less of the rim: its surroundings are what is hidden there."""
_RIM = 0.02
"""Width of the rim, as a share of the shorter side."""


def are_mattes(count: int, mask: Callable[[int], np.ndarray]) -> bool:
    """Whether masks cut a subject out of its surroundings.

    Such masks hide most of the rim of most photos. Those that hide passers-by, a tripod or the sky
    show most of it; those of a lens are the same for most photos.

    Args:
        count: How many there are, at least one.
        mask: [H, W] uint8 of the one with this number, 255 = keep; asked for some of them, and what
            it raises is raised.
    """
    looked_at = [mask(i) for i in range(0, count, -(-count // _LOOKED_AT))]
    most_alike = max(Counter(each.tobytes() for each in looked_at).values())
    if most_alike > max(len(looked_at) / 2, 1):
        return False
    kept = np.median([each.mean() for each in looked_at]) / 255
    rim = np.median([_rim(each).mean() for each in looked_at]) / 255
    return bool(kept < _KEPT and rim < _KEPT_RIM)


def _rim(mask: np.ndarray) -> np.ndarray:
    """The pixels near the sides of `mask` [H, W], in a row."""
    width = max(round(_RIM * min(mask.shape)), 1)
    inside = mask[width:-width]
    sides = (mask[:width], mask[-width:], inside[:, :width], inside[:, -width:])
    return np.concatenate([side.ravel() for side in sides])
