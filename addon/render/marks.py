"""Selection marks: tint of selected splats, and removal of hidden ones; no bpy, no gpu."""

from dataclasses import replace

import numpy as np

from ..core import Splats, sh_basis
from .mesh_copies import HIDDEN, SELECTED

TINT = np.float32([1.0, 0.5, 0.05])
"""sRGB values, near those of selected vertices in Blender's own themes."""
SHARE = np.float32(0.65)
"""Of the tint in the colour of a selected splat; the rest tells splats apart."""


def tinted(colors: np.ndarray, marks: np.ndarray) -> np.ndarray:
    """[B, 3] float32 colours [B, 3] of splats with these marks [B]."""
    chosen = (marks & SELECTED) != 0
    return np.where(chosen[:, None], colors + SHARE * (TINT - colors), colors)


def reselected(
    before: np.ndarray | None, after: np.ndarray | None, count: int
) -> np.ndarray | None:
    """[count] bool: which splats were selected or deselected from some marks to others, [count] or
    None; None where others show."""
    none = np.zeros(count, np.uint8)
    differ = (none if before is None else before) ^ (none if after is None else after)
    return None if (differ & HIDDEN).any() else differ != 0


def shown(marks: np.ndarray) -> np.ndarray:
    """[B] bool: which splats with these marks [B] show."""
    return (marks & HIDDEN) == 0


def tinted_splats(splats: Splats, marks: np.ndarray) -> Splats:
    """Splats as a picture of all of them has to be given them, with these marks [N]: without those
    that are hidden, and those that are selected tinted."""
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
