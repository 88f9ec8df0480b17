"""LOD build: levels of detail from a model on disk, a chunk at a time.

The model is read twice, in parts: once for the positions of its splats, once to put each into its
chunk of the finest level. Then each chunk of the next level is merged from four of the level below.
"""

import zlib
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..errors import ConfigError, DatasetError
from ..formats import file_origin, read_splat_parts
from ..formats.joined import joined
from ..io.files import atomic_write
from ..io.lod_file import (
    HEADER_BYTES,
    chunk_bytes,
    chunk_parts,
    lod_header,
)
from ..io.lod_index import CHILDREN, LodIndex, LodLevel, row_floats
from ..quoting import brief
from ..raster.native_library import default_threads
from ..scene import Cameras, splat_near
from ..sh import sh0_to_rgb
from ..splats import PARAMETERS, Splats
from .groups import chunks_of, groups_of, levels_above
from .merge_moments import MergedSplats, median_sizes, merged_by, projected_area

_PART = 1 << 17
"""Splats read at a time."""

OnShare = Callable[[str, float], object]
"""Progress callback: the phase, and its finished share, 0 to 1."""


@dataclass(frozen=True, kw_only=True)
class LodFacts:
    """Metadata for the file."""

    antialias: bool = False
    near: float | None = None
    """Near plane, world units; None: from the splats."""
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    cameras: Cameras | None = None


def build_lod(
    model: Path,
    output: Path,
    facts: LodFacts,
    *,
    on_share: OnShare = lambda what, share: None,
    measured: Callable[[Path, LodIndex], tuple[LodLevel, ...]] | None = None,
) -> LodIndex:
    """Write levels of detail of a model, completely or not at all.

    Args:
        model: A splat file of any format; a PLY is never completely in memory.
        output: The file to write.
        facts: Metadata for the file.
        on_share: Receives the progress.
        measured: Returns the levels with measured PSNR, from the unfinished file and its index.

    Returns:
        The index of the file.

    Raises:
        GsError: the model cannot be read, or the file cannot be written.
        ConfigError: the model has no splats.
    """
    means, degree = _means_of(model, on_share)
    if not len(means):
        raise ConfigError(
            f"{brief(model)} contains no splats that can be drawn. Give another model."
        )
    on_share("Sorting splats by position", 0.0)
    levels = levels_above(len(means))
    chunks = chunks_of(means, levels)
    near = splat_near(means) if facts.near is None else facts.near
    del means
    origin = file_origin(model)
    made: list[LodIndex] = []

    def write(file: BinaryIO) -> None:
        work = _Building(file, degree)
        work.finest(model, chunks, levels, on_share)
        work.coarser(on_share)
        index = LodIndex(
            sh_degree=degree,
            antialias=facts.antialias,
            near=near,
            background=facts.background,
            cameras=None if facts.cameras is None else facts.cameras.about(origin),
            origin=origin,
            levels=tuple(work.levels),
        )
        on_share("Measuring pictures of the levels", 0.0)
        made.append(work.finish(index, measured))

    atomic_write(output, write)
    return made[0]


def _means_of(model: Path, on_share: OnShare) -> tuple[np.ndarray, int]:
    """Means [N, 3] float32 of all splats, and their SH degree."""
    means, degree = [np.zeros((0, 3), np.float32)], 0
    on_share("Reading the splats", 0.0)
    for part in read_splat_parts(model, _PART):
        means.append(part.means)
        degree = part.sh_degree
    return np.concatenate(means), degree


class _Building:
    """A file whose chunks are being written."""

    def __init__(self, file: BinaryIO, degree: int) -> None:
        self._file, self._degree = file, degree
        self._floats = row_floats(degree)
        self._rows = 0
        self.levels: list[LodLevel] = []
        self._errors: list[np.ndarray] = []
        """Errors of the splats of the last level, by chunk."""

    def finest(self, model: Path, chunks: np.ndarray, levels: int, on_share: OnShare) -> None:
        """Write the chunks of the finest level."""
        counts = np.bincount(chunks, minlength=CHILDREN**levels)
        starts = np.cumsum(counts) - counts
        self._scatter(model, chunks, starts, on_share)
        stats = _Stats()
        self._file.flush()
        with Path(self._file.name).open("rb") as file:
            for start, count in zip(starts.tolist(), counts.tolist(), strict=True):
                file.seek(self._place(start))
                rows = np.frombuffer(file.read(4 * self._floats * count), "<f4")
                splats = _from_rows(rows.reshape(count, self._floats), self._degree)
                self._write(start, splats, stats, np.zeros(count))
        self._rows = len(chunks)
        self.levels.append(stats.level())
        self._errors = [np.zeros(count) for count in counts.tolist()]

    def _scatter(
        self, model: Path, chunks: np.ndarray, starts: np.ndarray, on_share: OnShare
    ) -> None:
        """Write each splat as a row into the range of its chunk."""
        filled, done = starts.copy(), 0
        for part in read_splat_parts(model, _PART):
            if len(part) > len(chunks) - done or part.sh_degree != self._degree:
                raise _changed(model)
            own = chunks[done : done + len(part)]
            order = np.argsort(own, kind="stable")
            rows = _to_rows(part)[order]
            firsts = np.flatnonzero(np.diff(own[order], prepend=-1))
            for first, end in zip(firsts, [*firsts[1:], len(own)], strict=True):
                chunk = own[order[first]]
                self._file.seek(self._place(int(filled[chunk])))
                self._file.write(rows[first:end].tobytes())
                filled[chunk] += end - first
            done += len(part)
            on_share("Putting splats into chunks", done / len(chunks))
        if done != len(chunks):
            raise _changed(model)

    def coarser(self, on_share: OnShare) -> None:
        """Write all coarser levels."""
        total = sum(CHILDREN**k for k in range(len(self._errors).bit_length() // 2 + 1)) or 1
        total -= len(self._errors)
        done = 0
        while len(self._errors) > 1:
            below, stats, errors = self.levels[-1], _Stats(), []
            begins = self._rows - below.splats + np.cumsum(below.counts) - below.counts
            for merged in self._parents(begins, below.counts):
                self._write(self._rows, merged.splats, stats, merged.errors)
                self._rows += len(merged.splats)
                errors.append(merged.errors)
                done += 1
                on_share("Merging splats", done / total)
            self.levels.append(stats.level())
            self._errors = errors

    def _parents(self, begins: np.ndarray, counts: np.ndarray) -> Iterator[MergedSplats]:
        """Chunks of the next level in order, merged on all cores.

        Args:
            begins: [C], first row of each chunk of the last level.
            counts: [C], its number of rows.
        """

        def merged(parent: int) -> MergedSplats:
            children = range(CHILDREN * parent, CHILDREN * (parent + 1))
            parts = [self._read(int(begins[c]), int(counts[c])) for c in children]
            return _coarser(joined(parts), np.concatenate([self._errors[c] for c in children]))

        threads = default_threads()
        with ThreadPoolExecutor(threads) as pool:
            for first in range(0, len(counts) // CHILDREN, 4 * threads):
                self._file.flush()
                last = min(first + 4 * threads, len(counts) // CHILDREN)
                yield from list(pool.map(merged, range(first, last)))

    def finish(
        self,
        index: LodIndex,
        measured: Callable[[Path, LodIndex], tuple[LodLevel, ...]] | None,
    ) -> LodIndex:
        """Write the index, then the header with its offset."""
        if measured is not None:
            self._file.flush()
            index = replace(index, levels=measured(Path(self._file.name), index))
        text = index.to_bytes()
        begin = self._place(self._rows)
        self._file.seek(begin)
        self._file.write(text)
        self._file.seek(0)
        self._file.write(lod_header(begin, len(text)))
        return index

    def _place(self, row: int) -> int:
        return HEADER_BYTES + 4 * self._floats * row

    def _read(self, row: int, count: int) -> Splats:
        with Path(self._file.name).open("rb") as file:
            file.seek(self._place(row))
            return Splats(**chunk_parts(file.read(4 * self._floats * count), self._degree))

    def _write(self, row: int, splats: Splats, stats: "_Stats", errors: np.ndarray) -> None:
        content = chunk_bytes(splats)
        self._file.seek(self._place(row))
        self._file.write(content)
        stats.add(splats, errors, zlib.crc32(content))


def _coarser(splats: Splats, errors: np.ndarray) -> MergedSplats:
    """Merge to a quarter of the splats."""
    count = -(-len(splats) // CHILDREN)
    group = groups_of(
        splats.means.astype(np.float64),
        projected_area(splats),
        median_sizes(splats),
        sh0_to_rgb(splats.sh0[:, 0].astype(np.float64)),
        count,
    )
    return merged_by(splats, errors, group, count)


class _Stats:
    """Collects index entries of the chunks of a level."""

    def __init__(self) -> None:
        self._counts: list[int] = []
        self._low: list[np.ndarray] = []
        self._high: list[np.ndarray] = []
        self._reach: list[float] = []
        self._errors: list[float] = []
        self._checks: list[int] = []

    def add(self, splats: Splats, errors: np.ndarray, check: int) -> None:
        """Add a chunk with the errors [N] of its splats, world units."""
        self._counts.append(len(splats))
        self._low.append(splats.means.min(axis=0))
        self._high.append(splats.means.max(axis=0))
        self._reach.append(float(np.exp(min(float(splats.scales.max()), _MOST_LOG))))
        self._errors.append(_mean_error(splats, errors))
        self._checks.append(check)

    def level(self) -> LodLevel:
        """The collected level."""
        return LodLevel(
            counts=np.array(self._counts, np.int64),
            low=np.array(self._low, np.float64),
            high=np.array(self._high, np.float64),
            reach=np.array(self._reach),
            errors=np.array(self._errors),
            checks=np.array(self._checks, np.int64),
        )


_MOST_LOG = 700.0
"""Largest log scale whose exponential fits in float64."""


def _mean_error(splats: Splats, errors: np.ndarray) -> float:
    """RMS error, weighted by the covered area, limited so that the largest tenth of the splats
    counts for about half: a few huge ones would hide the errors of all others."""
    weights = projected_area(splats)
    usual = np.sort(weights)[: -(-9 * len(weights) // 10)]
    weights = np.minimum(weights, 10 * usual.mean())
    return float(np.sqrt((weights * errors**2).sum() / weights.sum()))


def _to_rows(splats: Splats) -> np.ndarray:
    """[N, F] little-endian float32, one splat per row."""
    parts = [getattr(splats, name).reshape(len(splats), -1) for name in PARAMETERS]
    return np.concatenate(parts, axis=1).astype("<f4")


def _from_rows(rows: np.ndarray, degree: int) -> Splats:
    """Inverse of `_to_rows`."""
    shapes = {name: part.shape[1:] for name, part in chunk_parts(b"", degree).items()}
    values, at = {}, 0
    for name, shape in shapes.items():
        size = int(np.prod(shape))
        part = rows[:, at : at + size].reshape(len(rows), *shape)
        values[name] = np.ascontiguousarray(part, np.float32)
        at += size
    return Splats(**values)


def _changed(model: Path) -> DatasetError:
    return DatasetError(f"{brief(model)} changed while it was read. Try again.")
