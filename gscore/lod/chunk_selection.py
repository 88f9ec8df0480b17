"""Chunk selection: the visible chunks of a camera, each at the coarsest sufficient level."""

from dataclasses import dataclass

import numpy as np

from ..io.lod_index import CHILDREN, LodIndex, LodLevel
from ..raster.request import Frustum
from ..shared_constants import ALPHA_MIN, JACOBIAN_MARGIN

_FAINTEST = float(np.sqrt(-2 * np.log(ALPHA_MIN)))
"""Standard deviations at which an opaque splat falls below 1/255 and is no longer drawn."""
_CLAMP = 1 + JACOBIAN_MARGIN
"""Half-angles of the picture beyond which the rasterizer clamps the projection of covariances."""
_ROUNDING = 1.0
"""Margin around the picture for float32 rounding, px."""
_STEPS = 40
"""Bisection steps of the search for the error that limits the splats."""


@dataclass(frozen=True, kw_only=True)
class ChosenChunks:
    """Selection of chunks of a model for one camera."""

    chunks: tuple[tuple[int, int], ...]
    """Level and number of each chunk, finest first."""
    splats: int
    pixels: float
    """Allowed error: the requested one, or larger to limit the number of splats."""

    def by_level(self, levels: int) -> list[int]:
        """Number of chunks of each level, finest first."""
        counts = [0] * levels
        for level, _ in self.chunks:
            counts[level] += 1
        return counts


def choose_chunks(
    index: LodIndex, view: Frustum, pixels: float, *, eps2d: float, most: int | None = None
) -> ChosenChunks:
    """Chunks to render: they cover all space that the camera may see, without overlap.

    A chunk is selected if its error, at the distance of its box, is at most `pixels`; else its
    children are considered. Chunks that reach no pixel are left out; the test is conservative, so
    that no splat the rasterizer would draw is lost.

    Args:
        index: Index of the file.
        view: The camera.
        pixels: Allowed error, px; 0: the finest splats everywhere.
        eps2d: Added to splats on screen, px^2.
        most: Most splats, unless the coarsest chunks have more; None: no limit.
    """
    visible = [_may_be_visible(level, view, eps2d) for level in index.levels]
    errors = [_pixels_of(level, view) for level in index.levels]
    chosen = _chosen(index, visible, errors, pixels)
    if most is None or chosen.splats <= most:
        return chosen
    low, high = np.log(max(pixels, 1e-6)), np.log(1e9)
    for _ in range(_STEPS):
        middle = (low + high) / 2
        tried = _chosen(index, visible, errors, float(np.exp(middle)))
        low, high = (low, middle) if tried.splats <= most else (middle, high)
    return _chosen(index, visible, errors, float(np.exp(high)))


def _chosen(
    index: LodIndex, visible: list[np.ndarray], errors: list[np.ndarray], pixels: float
) -> ChosenChunks:
    chunks: list[tuple[int, int]] = []
    splats = 0
    open_chunks = np.ones(1, bool)
    for level in range(len(index.levels) - 1, -1, -1):
        open_chunks = open_chunks & visible[level]
        refined = open_chunks & (errors[level] > pixels) if level else np.zeros_like(open_chunks)
        taken = np.flatnonzero(open_chunks & ~refined)
        chunks += [(level, chunk) for chunk in taken.tolist()]
        splats += int(index.levels[level].counts[taken].sum())
        open_chunks = np.repeat(refined, CHILDREN)
    return ChosenChunks(chunks=tuple(reversed(chunks)), splats=splats, pixels=pixels)


def _pixels_of(level: LodLevel, view: Frustum) -> np.ndarray:
    """Error [C] of each chunk in pixels, at its nearest point; infinite around the camera."""
    viewmat = np.asarray(view.viewmat)
    eye = -viewmat[:3, :3].T @ viewmat[:3, 3]
    outside = np.maximum(np.maximum(level.low - eye, eye - level.high), 0)
    away = np.linalg.norm(outside, axis=1)
    focal = max(float(view.K[0, 0]), float(view.K[1, 1]))
    # An error of 0 of merged splats is plausible only if all splats are in one place.
    spacing = np.linalg.norm(level.high - level.low, axis=1) / np.sqrt(level.counts)
    errors = np.where(level.errors > 0, level.errors, spacing)
    with np.errstate(divide="ignore", invalid="ignore"):
        pixels = errors * focal / away
    return np.where(errors > 0, pixels, 0.0)


def _may_be_visible(level: LodLevel, view: Frustum, eps2d: float) -> np.ndarray:
    """Mask [C] bool, False for chunks of which no splat reaches a pixel.

    On screen a splat extends at most `_FAINTEST` standard deviations, each at most |J| s in the
    rasterizer's projection, with J at the clamped ends of the picture, plus `eps2d`. Multiplied by
    the depth, this is linear in the position of the splat, so testing the corners of a box is
    enough.
    """
    viewmat, K = np.asarray(view.viewmat), np.asarray(view.K)
    corners = np.stack([level.low, level.high], axis=1)[:, _CORNERS, np.arange(3)]  # [C, 8, 3]
    local = corners @ viewmat[:3, :3].T + viewmat[:3, 3]
    z = local[..., 2]
    visible = (z > view.near).any(axis=1)
    blur = _FAINTEST * np.sqrt(eps2d) + _ROUNDING
    for axis, size in ((0, view.width), (1, view.height)):
        focal, middle = K[axis, axis], K[axis, 2]
        slope = _CLAMP * max(middle, size - middle, size / 2) / focal
        wide = _FAINTEST * level.reach * focal * np.sqrt(1 + slope * slope)
        at = focal * local[..., axis]
        left, right = (middle + blur) * z, (size - middle + blur) * z
        visible &= (at + left + wide[:, None] >= 0).any(axis=1)
        visible &= (right - at + wide[:, None] >= 0).any(axis=1)
    return visible


_CORNERS = np.array([[i >> k & 1 for k in range(3)] for i in range(8)])
"""Bound, lower 0 or upper 1, of each of the eight corners of a box along each axis."""
