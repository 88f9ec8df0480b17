"""How selected splats look, and that hidden ones do not show; no bpy, no gpu."""

import numpy as np

from ..render.frozen import HIDDEN, SELECTED

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
