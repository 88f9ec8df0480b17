"""Selection marks: tint of selected splats, and removal of hidden ones; no bpy, no gpu."""

from dataclasses import replace

import numpy as np

from ..core import Splats, sh_basis
from .mesh_copies import HIDDEN, SELECTED

TINT = np.float32([1.0, 0.5, 0.05])
"""sRGB values, close to selected vertices in Blender's own themes."""
SHARE = np.float32(0.65)
"""Share of the tint in the colour of a selected splat; the rest keeps splats distinguishable."""


def tinted(colors: np.ndarray, marks: np.ndarray) -> np.ndarray:
    """Colours [B, 3] float32 of splats, tinted where their marks [B] are selected."""
    chosen = (marks & SELECTED) != 0
    return np.where(chosen[:, None], colors + SHARE * (TINT - colors), colors)


def reselected(
    before: np.ndarray | None, after: np.ndarray | None, count: int
) -> np.ndarray | None:
    """Splats that were selected or deselected between two sets of marks ([count] or None), [count]
    bool; None if visibility has changed."""
    none = np.zeros(count, np.uint8)
    differ = (none if before is None else before) ^ (none if after is None else after)
    return None if (differ & HIDDEN).any() else differ != 0


def shown(marks: np.ndarray) -> np.ndarray:
    """Splats that are not hidden by their marks [B], [B] bool."""
    return (marks & HIDDEN) == 0


def tinted_splats(splats: Splats, marks: np.ndarray) -> Splats:
    """Splats for a picture with marks [N]: without hidden splats, selected splats tinted."""
    there = shown(marks)
    if not there.all():
        splats, marks = splats.subset(there), marks[there]
    chosen = (marks & SELECTED) != 0
    if not chosen.any():
        return splats
    constant = sh_basis(0, np.zeros((1, 3), np.float32))[0, 0]
    sh0, shN = splats.sh0.copy(), splats.shN.copy()
    sh0[chosen] += SHARE * ((TINT - np.float32(0.5)) / constant - sh0[chosen])
    shN[chosen] *= 1 - SHARE
    return replace(splats, sh0=sh0, shN=shN)
