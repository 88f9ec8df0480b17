"""Overlay lines: lines drawn over everything, detected in Blender's picture; no bpy, no gpu."""

import numpy as np

_OPAQUE = 128
"""Overlay opacity, of 255, from which a pixel counts as covered."""
_AROUND = 2
"""Radius of the neighborhood from which a line's own depth differs, px."""
_NEARER = 1.05
"""Least factor by which a line with a depth of its own is nearer than its neighborhood."""


def in_front(depths: np.ndarray, alphas: np.ndarray) -> np.ndarray:
    """Pixels of overlays without a depth.

    Blender stores the depths of lines *In Front* where no add-on can read them, but draws their
    colours together with those of all overlays.

    Args:
        depths: [H, W] float32 in [0, 1], of meshes and of all other overlays.
        alphas: [H, W] uint8, opacities of overlays.

    Returns:
        [H, W] bool, including outlines of selected objects, which have no depth either.
    """
    covered = alphas >= _OPAQUE
    if not covered.any():
        return covered
    behind = depths
    for axis in (0, 1):
        behind = _highest(behind, axis, _AROUND)
    placed = (alphas > 0) & ((1 - depths) > _NEARER * (1 - behind))
    for axis in (0, 1):
        placed = _highest(placed, axis, 1)  # soft edges, which have no depth
    return covered & ~placed


def _highest(values: np.ndarray, axis: int, around: int) -> np.ndarray:
    """Maximum filter along an axis."""
    lines = np.moveaxis(values, axis, 0)
    out = lines.copy()
    for k in range(1, around + 1):
        np.maximum(out[k:], lines[:-k], out=out[k:])
        np.maximum(out[:-k], lines[k:], out=out[:-k])
    return np.moveaxis(out, 0, axis)
