"""Overlay lines: lines that Blender draws over everything, found in its picture; no bpy, no gpu."""

import numpy as np

_SEEN = 128
"""Of 255: opacity from which a pixel is hidden by its overlay."""
_AROUND = 2
"""Pixels to each side that a line's own depth differs from."""
_NEARER = 1.05
"""How many times nearer than what is around it a line with a depth of its own is, at least."""


def in_front(depths: np.ndarray, alphas: np.ndarray) -> np.ndarray:
    """Where overlays are that have left no depth.

    Blender keeps the depths of lines *In Front* apart, where no add-on can read them, but draws
    their colours with those of all overlays.

    Args:
        depths: [H, W] float32 in [0, 1], of meshes and of all other overlays.
        alphas: [H, W] uint8, opacities of overlays.

    Returns:
        [H, W] bool. Outlines of what is selected, which have no depth either, are among them.
    """
    seen = alphas >= _SEEN
    if not seen.any():
        return seen
    behind = depths
    for axis in (0, 1):
        behind = _highest(behind, axis, _AROUND)
    placed = (alphas > 0) & ((1 - depths) > _NEARER * (1 - behind))
    for axis in (0, 1):
        placed = _highest(placed, axis, 1)  # soft edges, which have no depth
    return seen & ~placed


def _highest(values: np.ndarray, axis: int, around: int) -> np.ndarray:
    """The largest of those around each along an axis."""
    lines = np.moveaxis(values, axis, 0)
    out = lines.copy()
    for k in range(1, around + 1):
        np.maximum(out[k:], lines[:-k], out=out[k:])
        np.maximum(out[:-k], lines[k:], out=out[:-k])
    return np.moveaxis(out, 0, axis)
