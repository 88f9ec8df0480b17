"""Order of blending: splats sorted by depth, and their colours from a view; no bpy, no gpu."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..core import Splats, sh_basis
from ..render.mesh_copies import shown, tinted
from .atlas import Atlas

_BLOCK = 1 << 14
"""Splats whose colours are computed together: they fit in the cache, and Blender's thread gets the
interpreter in between."""


@dataclass(frozen=True, kw_only=True)
class Eye:
    """Camera of a view, relative to each object."""

    viewmats: tuple[np.ndarray, ...]
    """[4, 4] float64 of each object: similarity from its space to the camera, OpenCV axes."""
    orthographic: bool


def arrange(
    atlas: Atlas, eye: Eye, count: int, marks: Sequence[np.ndarray | None] = ()
) -> np.ndarray:
    """Sort the first rows of an atlas.

    Args:
        atlas: The splats.
        eye: The camera, with one matrix per object of the atlas.
        count: Number of rows.
        marks: Marks of each object's splats, [N] uint8 (`render.mesh_copies`), or None; empty: no
            marks.

    Returns:
        [M, 4] float32, M = `count` minus hidden splats, the farthest first: index of the row, and
        its colour in this view, sRGB values of at least 0.
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
            colors[here] = _colors(atlas, here, number, eye, marked)
            if marked is not None:
                there[here] = shown(marked[atlas.index[here]])
    farthest = np.argsort(-depths, kind="stable")
    farthest = farthest[there[farthest]]
    out = np.empty((len(farthest), 4), np.float32)
    out[:, 0], out[:, 1:] = farthest, colors[farthest]
    return out


def recolored(
    entries: np.ndarray,
    atlas: Atlas,
    eye: Eye,
    rows: np.ndarray,
    marks: Sequence[np.ndarray | None] = (),
) -> np.ndarray:
    """The result of `arrange` with new colours of some rows; positions and order are the same.

    Args:
        entries: [M, 4], for the same eye.
        atlas: The splats.
        eye: As for `arrange`.
        rows: Rows of the atlas whose colours are computed again, [N] bool.
        marks: As for `arrange`; the same splats are hidden as in `entries`.
    """
    out = entries.copy()
    row = entries[:, 0].astype(np.int32)
    places = np.flatnonzero(rows[row])
    part = atlas.part[row[places]]
    for number in range(len(eye.viewmats)):
        own = places[part == number]
        marked = marks[number] if marks else None
        for at in range(0, len(own), _BLOCK):
            here = own[at : at + _BLOCK]
            out[here, 1:] = _colors(atlas, row[here], number, eye, marked)
    return out


def _colors(
    atlas: Atlas, rows: np.ndarray, number: int, eye: Eye, marked: np.ndarray | None
) -> np.ndarray:
    """sRGB values [B, 3] of some rows of an atlas, all of one object, tinted if selected."""
    index = atlas.index[rows]
    colors = shown_colors(
        atlas.parts[number], index, eye.viewmats[number], orthographic=eye.orthographic
    )
    return colors if marked is None else tinted(colors, marked[index])


def shown_colors(
    splats: Splats, index: np.ndarray, viewmat: np.ndarray, *, orthographic: bool
) -> np.ndarray:
    """View-dependent sRGB values of some splats of an object, [B, 3] float32.

    Args:
        splats: The object's, in its own space.
        index: [B], indices of the splats.
        viewmat: [4, 4] float64, similarity from that space to the camera.
        orthographic: Whether rays are parallel.
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
