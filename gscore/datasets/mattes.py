"""What the masks of a folder mean: mattes of a subject, or pixels to leave out."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..io.images import read_mask

_LOOKED_AT = 12
"""Masks that are read, spread over the views."""
_KEPT = 0.7
"""A subject covers less of its photo."""
_KEPT_RIM = 0.25
"""And less of the rim: its surroundings are what is hidden there."""
_RIM = 0.02
"""Width of the rim, as a share of the shorter side."""


def are_mattes(masks: Sequence[Path], *, inverted: bool = False) -> bool:
    """Whether masks cut a subject out of its surroundings.

    Such masks hide most of the rim of most photos. Those that hide passers-by, a tripod or the sky
    show most of it; those of a lens are the same for most photos.

    Args:
        masks: Files of the masks, at least one.
        inverted: Their white marks what to leave out.

    Raises:
        FormatError: a file is corrupt.
    """
    step = -(-len(masks) // _LOOKED_AT)
    looked_at = [read_mask(file, inverted=inverted) for file in masks[::step]]
    most_alike = max(Counter(mask.tobytes() for mask in looked_at).values())
    if most_alike > max(len(looked_at) / 2, 1):
        return False
    kept = np.median([mask.mean() for mask in looked_at]) / 255
    rim = np.median([_rim(mask).mean() for mask in looked_at]) / 255
    return bool(kept < _KEPT and rim < _KEPT_RIM)


def _rim(mask: np.ndarray) -> np.ndarray:
    """The pixels near the sides of `mask` [H, W], in a row."""
    width = max(round(_RIM * min(mask.shape)), 1)
    inside = mask[width:-width]
    sides = (mask[:width], mask[-width:], inside[:, :width], inside[:, -width:])
    return np.concatenate([side.ravel() for side in sides])
