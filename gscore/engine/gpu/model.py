"""GPU model: parameters, Adam moments and per-splat counters on a device, kept in the same rows."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from ...raster.gpu import header
from ...raster.gpu.gpu_raster import GpuRaster
from ...raster.gpu.gpu_rows import GpuRows
from ...raster.header import ADAM_PENDING_SIZE
from ...splats import PARAMETERS, SH_REST_BY_DEGREE
from ..base import Columns, EngineModel, RowEdit, column_key, counters_of
from ..cpu.engine import CpuEngine
from ..cpu.model import ACCUMULATED, LAZY_COUNTERS, morton_bounds


class GpuModel(EngineModel):
    """N splats on a device with their Adam moments, accumulated gradients and counters.

    SH coefficients are stored up to the degree in use. No row skips steps, so all columns are
    current. A checkpoint has the format of `CpuModel`.
    """

    def __init__(
        self,
        raster: GpuRaster,
        columns: Columns,
        *,
        counters: Sequence[str] = (),
        frozen: Columns | None = None,
    ) -> None:
        """Copy raw parameters, as in `Splats`, to the device; moments and counters are zero.

        `counters`: names of the float32 counters of a strategy. `frozen`: raw parameters of splats
        that are drawn with the model but never change.
        """
        self.adam_steps = dict.fromkeys(PARAMETERS, 0)
        self.frozen = frozen
        """Raw parameters of the frozen splats; None: none."""
        self._counters = tuple(counters)
        self._sh_rest = columns["shN"].shape[1]
        self.rows = GpuRows(
            raster,
            _arrays(columns),
            frozen=None if frozen is None else _arrays(frozen),
            counters=len(self._counters),
        )
        """Tables on the device."""

    @classmethod
    def load(
        cls,
        raster: GpuRaster,
        saved: Columns,
        adam_steps: Mapping[str, int],
        *,
        frozen: Columns | None = None,
    ) -> "GpuModel":
        """Create a model from `save` of any engine; takes ownership of the arrays."""
        cpu = CpuEngine().load(saved, adam_steps)
        cpu.sync()  # rows of the CPU engine may have pending steps
        found = cpu.save()
        counters = {k: v for k, v in counters_of(found).items() if k not in LAZY_COUNTERS}
        columns = {name: found[column_key(name)] for name in PARAMETERS}
        model = cls(raster, columns, counters=tuple(counters), frozen=frozen)
        model.adam_steps = dict(adam_steps)
        for name in PARAMETERS:
            model._write(header.MOMENT1, name, found[f"m1/{name}"])
            model._write(header.MOMENT2, name, found[f"m2/{name}"])
        model._write(header.ACCUMULATED, "shN", found[ACCUMULATED])
        for name, counter in counters.items():
            model._write(header.COUNTERS, name, counter)
        return model

    @property
    def widths(self) -> dict[str, tuple[int, ...]]:
        """Shape of a row of each column, by name."""
        shapes = ((3,), (4,), (3,), (), (1, 3), (self._sh_rest, 3))
        return dict(zip(PARAMETERS, shapes, strict=True)) | dict.fromkeys(self._counters, ())

    @property
    def sh_degree(self) -> int:
        """Degree of the SH coefficients stored, 0 to 3."""
        return math.isqrt(self._sh_rest + 1) - 1

    def __len__(self) -> int:
        return len(self.rows)

    def column(self, name: str) -> np.ndarray:
        """Return a copy of a parameter or counter, [N, ...]."""
        return self._read(_table(name), name)

    def gather(self, name: str, rows: np.ndarray) -> np.ndarray:
        """Return some rows, [M] int64, of a parameter or counter."""
        return self._read(_table(name), name, _numbers(rows))

    def part(self, begin: int, end: int) -> dict[str, np.ndarray]:
        """Return the raw parameters of some rows, see `EngineModel.part`."""
        end = min(end, len(self))
        return {name: self._read(header.VALUES, name, begin=begin, end=end) for name in PARAMETERS}

    def edit(self, edit: RowEdit) -> None:
        """Apply an edit to parameters, moments, accumulated gradients and counters."""
        rebuilds = edit.moves_rows or edit.morton
        kept = len(self) if edit.keep is None else len(edit.keep)
        added = 0 if edit.parents is None else len(edit.parents)
        if rebuilds:
            self.rows.reserve(kept + added)  # before the first change, because it may fail
        rows = None if edit.rows is None else _numbers(edit.rows)
        for name, values in edit.values.items():
            self._write(_table(name), name, values, rows)
        for name in edit.forget:
            for table in (header.MOMENT1, header.MOMENT2):
                self.rows.clear(table, self._first(name), self._width(name), rows)
        if rebuilds:
            self.rows.rebuild(*self._sources(edit))
        for name, values in edit.changes.items():
            self._write(header.VALUES, name, values, np.arange(kept, kept + added))

    def widen_sh(self, degree: int) -> None:
        """Extend the SH coefficients to at least `degree`; new ones and their moments are zero."""
        if SH_REST_BY_DEGREE[degree] > self._sh_rest:  # else steps in flight would be waited for
            self._sh_rest = SH_REST_BY_DEGREE[degree]
            self.rows.widen(self._sh_rest)

    def clamp_runaways(self, extent: float) -> int:
        """Reset runaway rows and clamp saturated parameters; returns the number of reset rows."""
        return self.rows.clamp(extent)

    def finish(self) -> None:
        """Free moments and accumulated gradients."""
        self.drop_moments()

    def drop_moments(self) -> None:
        """Free moments and accumulated gradients, which only further steps need."""
        self.rows.drop_moments()

    def save(self) -> dict[str, np.ndarray]:
        """Return all that the next step depends on, see `EngineModel.save`."""
        out = {column_key(name): self.column(name) for name in self.widths}
        if self.rows.has_moments:
            for name in PARAMETERS:
                out[f"m1/{name}"] = self._read(header.MOMENT1, name)
                out[f"m2/{name}"] = self._read(header.MOMENT2, name)
            out[ACCUMULATED] = self._read(header.ACCUMULATED, "shN")
        # What the CPU engine needs for pending steps: there are none.
        out["drift"] = np.zeros(ADAM_PENDING_SIZE)
        return out | {column_key(name): np.zeros(len(self), np.uint8) for name in LAZY_COUNTERS}

    def counter(self, name: str) -> int:
        """Number of a counter."""
        return self._counters.index(name)

    def close(self) -> None:
        """Free all memory of the device."""
        self.rows.close()

    def _sources(self, edit: RowEdit) -> tuple[np.ndarray, np.ndarray]:
        """Old row of each new one, [M] int64, and 1 where it starts without moments, [M] uint8."""
        rows = np.arange(len(self))
        fresh = np.zeros(len(self), np.uint8)
        if edit.moved is not None and edit.sources is not None:
            rows[edit.moved] = edit.sources
            fresh[edit.moved] = 1
        if edit.morton or edit.keep is not None:
            keep = np.arange(len(self)) if edit.keep is None else edit.keep
            if edit.morton:
                keep = keep[self._morton_order(rows[keep])]
            kept, fresh = rows[keep], fresh[keep]
        else:
            kept = rows
        if edit.parents is not None:
            kept = np.concatenate([kept, rows[edit.parents]])
            fresh = np.concatenate([fresh, np.ones(len(edit.parents), np.uint8)])
        return kept, fresh

    def _morton_order(self, rows: np.ndarray) -> np.ndarray:
        """Places in `rows`, [M] int64, in the Morton order of their means."""
        if len(rows) == 0:
            return rows
        sample = rows[:: max(1, len(rows) // 4096)]
        low, high = morton_bounds(self.gather("means", sample))
        return self.rows.morton_order(low, high, rows)

    def _first(self, name: str) -> int:
        """First component of a parameter, or number of a counter."""
        return header.COMPONENTS[name] if name in header.COMPONENTS else self._counters.index(name)

    def _width(self, name: str) -> int:
        return math.prod(self.widths[name])

    def _read(
        self,
        table: int,
        name: str,
        rows: np.ndarray | None = None,
        *,
        begin: int = 0,
        end: int | None = None,
    ) -> np.ndarray:
        width = self._width(name)
        found = self.rows.read(table, self._first(name), width, rows, begin=begin, end=end)
        return found.reshape(len(found), *self.widths[name])

    def _write(
        self, table: int, name: str, values: np.ndarray, rows: np.ndarray | None = None
    ) -> None:
        flat = np.ascontiguousarray(values, np.float32).reshape(len(values), self._width(name))
        self.rows.write(table, self._first(name), flat, rows)


def _table(name: str) -> int:
    """Table of a column."""
    return header.VALUES if name in header.COMPONENTS else header.COUNTERS


def _arrays(columns: Columns) -> list[np.ndarray]:
    """`PARAMETERS` in their order, as the library reads them."""
    return [np.ascontiguousarray(columns[name], np.float32) for name in PARAMETERS]


def _numbers(rows: np.ndarray) -> np.ndarray:
    """Row numbers as the library reads them."""
    return np.ascontiguousarray(rows, np.int64)
