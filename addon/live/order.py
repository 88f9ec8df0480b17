"""The order in which splats are blended, and the colours they show to a view; no bpy, no gpu."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..core import Splats, sh_basis
from .atlas import Atlas
from .marks import shown, tinted

_BLOCK = 1 << 14
"""Splats whose colours are computed at once: they stay in the cache, and Blender's thread gets
its turns."""


@dataclass(frozen=True, kw_only=True)
class Eye:
    """From where splats are seen."""

    viewmats: tuple[np.ndarray, ...]
    """[4, 4] float64 of each object: similarity from its space to the camera, OpenCV axes."""
    orthographic: bool


def arrange(
    atlas: Atlas, eye: Eye, count: int, marks: Sequence[np.ndarray | None] = ()
) -> np.ndarray:
    """Sort the first rows of an atlas.

    Args:
        atlas: The splats.
        eye: Has one matrix for each of its objects.
        count: How many rows.
        marks: [N] uint8 of each object's splats (`render.frozen`), or None; empty: of none.

    Returns:
        [M, 4] float32, M = `count` less those that do not show, the farthest first: number of the
        row, and its colour in this view, sRGB values of at least 0.
    """
    count = min(count, len(atlas))
    depths = np.empty(count, np.float32)
    colors = np.empty((count, 3), np.float32)
    there = np.ones(count, bool)
    for number, viewmat in enumerate(eye.viewmats):
        marked = marks[number] if marks else None
        rows = np.flatnonzero(atlas.part[:count] == number)
        for at in range(0, len(rows), _BLOCK):
            here = rows[at : at + _BLOCK]
            means = atlas.means[here]
            depths[here] = means @ viewmat[2, :3].astype(np.float32) + np.float32(viewmat[2, 3])
            colors[here] = shown_colors(
                atlas.parts[number], atlas.index[here], viewmat, orthographic=eye.orthographic
            )
            if marked is not None:
                own = marked[atlas.index[here]]
                colors[here], there[here] = tinted(colors[here], own), shown(own)
    farthest = np.argsort(-depths, kind="stable")
    farthest = farthest[there[farthest]]
    out = np.empty((len(farthest), 4), np.float32)
    out[:, 0], out[:, 1:] = farthest, colors[farthest]
    return out


def shown_colors(
    splats: Splats, index: np.ndarray, viewmat: np.ndarray, *, orthographic: bool
) -> np.ndarray:
    """[B, 3] float32 sRGB values of some splats of an object as a view sees them.

    Args:
        splats: The object's, in its own space.
        index: [B], which of them.
        viewmat: [4, 4] float64, similarity from that space to the camera.
        orthographic: Parallel rays.
    """
    linear = viewmat[:3, :3]
    if orthographic:
        offsets = np.broadcast_to(linear[2].astype(np.float32), (len(index), 3))
    else:
        center = np.linalg.solve(linear, -viewmat[:3, 3])
        offsets = splats.means[index] - center.astype(np.float32)
    lengths = np.linalg.norm(offsets, axis=1, keepdims=True)
    count = splats.shN.shape[1] + 1
    degree = int(count**0.5) - 1
    basis = sh_basis(degree, offsets / np.maximum(lengths, np.float32(1e-30)))
    colors = np.float32(0.5) + basis[:, :1] * splats.sh0[index, 0]
    if degree:
        colors = colors + np.einsum("bk,bkc->bc", basis[:, 1:], splats.shN[index])
    return np.maximum(colors, np.float32(0))
