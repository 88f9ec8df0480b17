"""LOD renderer: pictures of a model with levels of detail, read from disk on demand."""

from pathlib import Path
from typing import Any

import numpy as np

from ..io.lod_file import LodFile, empty_splats, open_lod_file
from ..io.lod_index import LodIndex
from ..raster.api import Rendered, render
from ..raster.request import Frustum
from ..shared_constants import EPS2D
from ..splats import Splats
from .chunk_selection import ChosenChunks, choose_chunks

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
