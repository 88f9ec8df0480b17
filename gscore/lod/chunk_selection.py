"""Chunk selection: the visible chunks of a camera, each at the coarsest sufficient level."""

from dataclasses import dataclass

import numpy as np

from ..io.lod_index import CHILDREN, LodIndex, LodLevel
from ..raster.request import Frustum

_FAINTEST = float(np.sqrt(2 * np.log(255.0)))
"""Standard deviations at which an opaque splat falls below 1/255, where it is no longer drawn."""
_CLAMP = 1.3
"""Half-angles of the picture beyond which the rasterizer's projection of shapes is clamped."""
_ROUNDING = 1.0
"""Pixels around the picture, for what float32 makes of the edges."""
_STEPS = 40
"""Of the search for the error at which the splats fit."""


@dataclass(frozen=True, kw_only=True)
class ChosenChunks:
    """Selection of chunks of a model for one camera."""

    chunks: tuple[tuple[int, int], ...]
    """Level and number of each chunk, finest first."""
    splats: int
    pixels: float
    """The error that was allowed: as asked for, or more so that not too many splats are drawn."""

    def by_level(self, levels: int) -> list[int]:
        """How many chunks of each level there are, finest first."""
        counts = [0] * levels
        for level, _ in self.chunks:
            counts[level] += 1
        return counts


def choose_chunks(
    index: LodIndex, view: Frustum, pixels: float, *, eps2d: float, most: int | None = None
) -> ChosenChunks:
    """The chunks to draw: every place that the camera may see once.

    A chunk is taken where the error of its level, at the distance of its box, is no more than so
    many pixels; else those that it stands for. Chunks that reach no pixel are left out; what the
    rasterizer would draw of the others is never among them.

    Args:
        index: Of the file.
        view: The camera.
        pixels: Allowed error, px; 0: the finest splats everywhere.
        eps2d: Added to splats on screen, px^2.
        most: Splats that are drawn at most, unless the coarsest chunks have more; None: any number.
    """
    seen = [_may_be_seen(level, view, eps2d) for level in index.levels]
    errors = [_pixels_of(level, view) for level in index.levels]
    chosen = _chosen(index, seen, errors, pixels)
    if most is None or chosen.splats <= most:
        return chosen
    low, high = np.log(max(pixels, 1e-6)), np.log(1e9)
    for _ in range(_STEPS):
        middle = (low + high) / 2
        found = _chosen(index, seen, errors, float(np.exp(middle)))
        low, high = (low, middle) if found.splats <= most else (middle, high)
    return _chosen(index, seen, errors, float(np.exp(high)))


def _chosen(
    index: LodIndex, seen: list[np.ndarray], errors: list[np.ndarray], pixels: float
) -> ChosenChunks:
    chunks: list[tuple[int, int]] = []
    splats = 0
    wanted = np.ones(1, bool)
    for level in range(len(index.levels) - 1, -1, -1):
        wanted = wanted & seen[level]
        refined = wanted & (errors[level] > pixels) if level else np.zeros_like(wanted)
        taken = np.flatnonzero(wanted & ~refined)
        chunks += [(level, chunk) for chunk in taken.tolist()]
        splats += int(index.levels[level].counts[taken].sum())
        wanted = np.repeat(refined, CHILDREN)
    return ChosenChunks(chunks=tuple(reversed(chunks)), splats=splats, pixels=pixels)


def _pixels_of(level: LodLevel, view: Frustum) -> np.ndarray:
    """[C] how many pixels the error of a chunk is at its nearest; infinite around the camera."""
    viewmat = np.asarray(view.viewmat)
    eye = -viewmat[:3, :3].T @ viewmat[:3, 3]
    outside = np.maximum(np.maximum(level.low - eye, eye - level.high), 0)
    away = np.linalg.norm(outside, axis=1)
    focal = max(float(view.K[0, 0]), float(view.K[1, 1]))
    # An error of 0 of splats that stand for others is believed where these lie in one place alone.
    spacing = np.linalg.norm(level.high - level.low, axis=1) / np.sqrt(level.counts)
    errors = np.where(level.errors > 0, level.errors, spacing)
    with np.errstate(divide="ignore", invalid="ignore"):
        found = errors * focal / away
    return np.where(errors > 0, found, 0.0)


def _may_be_seen(level: LodLevel, view: Frustum, eps2d: float) -> np.ndarray:
    """[C] bool: False where no splat of a chunk reaches a pixel.

    On screen a splat has at most `_FAINTEST` standard deviations, of which the rasterizer's own
    projection says |J| s at most, with J at the clamped ends of the picture, besides `eps2d`.
    Multiplied by the depth, all of this is linear in the place of the splat, so that the corners of
    a box decide.
    """
    viewmat, K = np.asarray(view.viewmat), np.asarray(view.K)
    corners = np.stack([level.low, level.high], axis=1)[:, _CORNERS, np.arange(3)]  # [C, 8, 3]
    local = corners @ viewmat[:3, :3].T + viewmat[:3, 3]
    z = local[..., 2]
    found = (z > view.near).any(axis=1)
    blur = _FAINTEST * np.sqrt(eps2d) + _ROUNDING
    for axis, size in ((0, view.width), (1, view.height)):
        focal, middle = K[axis, axis], K[axis, 2]
        slope = _CLAMP * max(middle, size - middle, size / 2) / focal
        wide = _FAINTEST * level.reach * focal * np.sqrt(1 + slope * slope)
        at = focal * local[..., axis]
        left, right = (middle + blur) * z, (size - middle + blur) * z
        found &= (at + left + wide[:, None] >= 0).any(axis=1)
        found &= (right - at + wide[:, None] >= 0).any(axis=1)
    return found


_CORNERS = np.array([[i >> k & 1 for k in range(3)] for i in range(8)])
"""Which of both ends each of the eight corners of a box has along each axis."""
