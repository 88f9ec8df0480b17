"""LOD renderer: pictures of a model with levels of detail, read from disk on demand."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..io.lod_file import LodFile, empty_splats, open_lod_file
from ..io.lod_index import CHILDREN, LodIndex, LodLevel
from ..raster.api import Rendered, render
from ..raster.request import Frustum
from ..shared_constants import ALPHA_MIN, EPS2D, JACOBIAN_MARGIN
from ..splats import Splats

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


LOD_PX = 1.0
"""Allowed error of the picture, px."""
_HIDDEN = np.float32(-100)
"""Opacity logit of invisible splats, which pad chunks to equal sizes."""


class LodModel:
    """Renderer of an LOD file; close it, or use it in a `with`.

    Chunks of the last picture stay in memory, so that only new ones are read for the next.
    """

    def __init__(self, path: str | Path) -> None:
        """Open a file that `gscore lod` wrote.

        Raises:
            DatasetError: it is missing or cannot be read.
            FormatError: it is not an LOD file, truncated or damaged.
        """
        self._file = open_lod_file(path)
        self._room = max(int(level.counts.max()) for level in self.index.levels)
        self._slots: dict[tuple[int, int], int] = {}
        self._arrays = empty_splats(0, self.index.sh_degree)
        self.chosen: ChosenChunks | None = None
        """Selection of the last picture."""

    def __enter__(self) -> "LodModel":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file and free the memory."""
        self._file.close()
        self._slots, self._arrays = {}, empty_splats(0, self.index.sh_degree)

    @property
    def index(self) -> LodIndex:
        """Index of the file."""
        return self._file.index

    @property
    def file(self) -> LodFile:
        """The open file."""
        return self._file

    def render(
        self,
        K: np.ndarray,
        viewmat: np.ndarray,
        width: int,
        height: int,
        *,
        lod_px: float = LOD_PX,
        most: int | None = None,
        near: float | None = None,
        eps2d: float = EPS2D,
        **how: Any,
    ) -> Rendered:
        """Render as `gscore.render`, with coarser levels for distant splats.

        Args:
            K: [3, 3] pixels.
            viewmat: [4, 4] world to camera.
            width: Pixels.
            height: Pixels.
            lod_px: Allowed error of coarser levels, px; 0: the finest splats everywhere.
            most: Most splats; more increase the allowed error.
            near: Splats with z at or below this are not drawn; None: as trained.
            eps2d: Added to the diagonal of the 2D covariance, px^2.
            **how: Further arguments of `gscore.render`: background, sh_degree, antialias, depths,
                threads and others; antialias defaults to that of the training.

        Raises:
            As `gscore.render`; FormatError: a chunk is damaged.
        """
        near = self.index.near if near is None else near
        view = Frustum(np.asarray(viewmat), np.asarray(K), width, height, near)
        self.chosen = choose_chunks(self.index, view, lod_px, eps2d=eps2d, most=most)
        splats = self._gather(self.chosen)
        how = {"antialias": self.index.antialias} | how
        return render(splats, K, viewmat, width, height, near=near, eps2d=eps2d, **how)

    def _gather(self, chosen: ChosenChunks) -> Splats:
        """Splats of these chunks; those of the last picture keep their slots if possible."""
        needed = set(chosen.chunks)
        kept = {chunk: slot for chunk, slot in self._slots.items() if chunk in needed}
        self._slots = kept
        self._grow(len(needed))
        free = iter(sorted(set(range(len(needed))) - set(kept.values())))
        for chunk in [one for one, slot in kept.items() if slot >= len(needed)]:
            self._move(chunk, next(free))
        for chunk in chosen.chunks:
            if chunk not in kept:
                self._read(chunk, next(free))
        end = len(needed) * self._room
        return Splats(**{name: array[:end] for name, array in self._arrays.items()})

    def _grow(self, slots: int) -> None:
        """Reserve space for this number of chunks."""
        have = len(self._arrays["means"])
        if have >= slots * self._room:
            return
        rows = slots * self._room
        if self._slots:  # camera paths: later pictures may need a little more
            rows += rows // 8
        larger = empty_splats(rows, self.index.sh_degree)
        for name, array in larger.items():
            array[:have] = self._arrays[name]
            del self._arrays[name]  # immediately, so that two whole models are never in memory
        self._arrays = larger

    def _rows(self, slot: int) -> slice:
        return slice(slot * self._room, (slot + 1) * self._room)

    def _move(self, chunk: tuple[int, int], slot: int) -> None:
        old, new = self._rows(self._slots[chunk]), self._rows(slot)
        for array in self._arrays.values():
            array[new] = array[old]
        self._slots[chunk] = slot

    def _read(self, chunk: tuple[int, int], slot: int) -> None:
        begin, room = slot * self._room, self._room
        parts = self._file.chunk(*chunk)
        count = len(parts["means"])
        for name, part in parts.items():
            self._arrays[name][begin : begin + count] = part
        self._blank(begin + count, begin + room)
        self._slots[chunk] = slot

    def _blank(self, begin: int, end: int) -> None:
        """Fill rows with invisible splats."""
        for array in self._arrays.values():
            array[begin:end] = 0
        self._arrays["quats"][begin:end, 0] = 1
        self._arrays["opacities"][begin:end] = _HIDDEN
