"""Rows of splats in training on a device: columns, edits, clamps, noise, Morton order."""

import ctypes as ct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .. import arguments
from ..buffers import INT64, UINT8, Array, address, optional
from ..header import RandomStruct
from ..request import Frustum, Settings
from . import header
from .gpu_raster import GpuRaster
from .library import library

_pointer = ct.c_void_p


class GpuRows:
    """gs_gpu_model: tables of rows on a device.

    Row numbers do not count frozen splats. Tables and components are those of `header`. Closing the
    device closes its rows. Errors of all methods are those of `GpuRaster.forward`.
    """

    def __init__(
        self,
        raster: GpuRaster,
        splats: Sequence[np.ndarray],
        *,
        frozen: Sequence[np.ndarray] | None = None,
        counters: int = 0,
    ) -> None:
        """Copy splats to the device; all tables but the values are zero.

        Args:
            raster: The device.
            splats: Raw `PARAMETERS`, in their order.
            frozen: Those of splats in front that are drawn but never change; their SH degree may be
                lower. None: none.
            counters: Number of counters.
        """
        self.handle = _pointer()
        self._raster = raster
        self._lib = library()
        settings = Settings(raw=True)
        before = None if frozen is None else ct.byref(arguments.splats(frozen, settings))
        content = arguments.splats(splats, settings)
        made = ct.byref(self.handle)
        raster.call(self._lib.gs_gpu_model_create, ct.byref(content), before, counters, made)
        raster.content.add(self)
        self._count = len(splats[0])
        self._frozen = 0 if frozen is None else len(frozen[0])
        self._splats = _pointer()
        self._call("splats", ct.byref(self._splats))
        self.has_moments = True
        """Whether moments and accumulated gradients exist."""

    def __len__(self) -> int:
        """Number of rows that are not frozen."""
        return self._count

    def __del__(self) -> None:
        if getattr(self, "_lib", None) is not None:
            self.close()

    def close(self) -> None:
        """Free the memory; twice does no harm."""
        handle, self.handle = self.handle, _pointer()
        if handle and self._raster.usable:
            with self._raster.lend():
                self._lib.gs_gpu_model_destroy(handle)

    def read(
        self,
        table: int,
        first: int,
        width: int,
        rows: np.ndarray | None = None,
        *,
        begin: int = 0,
        end: int | None = None,
    ) -> np.ndarray:
        """Copy components of rows.

        Args:
            table: Number of the table.
            first: Number of the first component.
            width: Number of components.
            rows: [M] int64; None: those from `begin` to `end`.
            begin: First row, without `rows`.
            end: End of the rows; None: all.

        Returns:
            [M, width] float32.
        """
        count = len(rows) if rows is not None else (len(self) if end is None else end) - begin
        out = np.empty((count, width), np.float32)
        if out.size:
            self._columns("read", table, (first, width), rows, begin, out)
        return out

    def write(
        self, table: int, first: int, values: np.ndarray, rows: np.ndarray | None = None
    ) -> None:
        """Overwrite components of rows with `values`, [M, width] float32; `rows`, [M] int64, must
        differ; None: all."""
        if values.size:
            self._columns("write", table, (first, values.shape[1]), rows, 0, values)

    def clear(self, table: int, first: int, width: int, rows: np.ndarray | None = None) -> None:
        """Set components of rows, [M] int64, to zero; None: all."""
        count = len(self) if rows is None else len(rows)
        if count and width:
            columns = self._columns_struct(table, (first, width), rows, 0, count)
            self._call("write", ct.byref(columns), None)

    def draw(
        self,
        view: Frustum,
        settings: Settings,
        pictures: Mapping[str, Array],
        *,
        sh_degree: int,
    ) -> None:
        """gs_gpu_draw of all splats, frozen ones first.

        Args:
            view: Camera and picture size.
            settings: Render settings; `sh_degree`, `threads` and `disable` have no effect.
            pictures: Output arrays, by the names of gs_image.
            sh_degree: SH degree to evaluate, at most the stored one.
        """
        count = self._frozen + len(self)
        image = arguments.image(pictures, view, settings.outputs, count)
        camera = arguments.view(view, settings, sh_degree)
        drawn = [ct.byref(camera), ct.byref(arguments.host(view, settings)), ct.byref(image)]
        self._raster.call(self._lib.gs_gpu_draw, self._splats, *drawn)

    def weights(self, view: Frustum, shares: np.ndarray) -> np.ndarray:
        """Blending weights in the last view drawn, summed over pixels, as `GpuRaster.weights`.

        Args:
            view: As in that call of `draw`.
            shares: [H, W, 3] float32.

        Returns:
            [N, 3] float32, without frozen splats.
        """
        sums = np.zeros((self._frozen + len(self), 3), np.float32)
        found = address("shares", shares, (view.height, view.width, 3))
        self._raster.call(self._lib.gs_gpu_weights, self._splats, found, sums.ctypes.data)
        return sums[self._frozen :]

    def reserve(self, count: int) -> None:
        """Take the memory that a `rebuild` to `count` rows needs; the rows stay."""
        self._call("reserve", count)

    def rebuild(self, rows: np.ndarray, fresh: np.ndarray) -> None:
        """Make row i of the old row `rows[i]`, [M] int64, without moments, accumulated gradients
        and counters where `fresh`, [M] uint8, is not 0."""
        found = address("rows", rows, (len(rows),), INT64)
        marks = address("fresh", fresh, (len(rows),), UINT8)
        self._call("rebuild", found, marks, len(rows))
        self._count = len(rows)

    def widen(self, sh_rest: int) -> None:
        """Extend the SH coefficients to `sh_rest` beyond the constant one, with zeros."""
        self._call("widen", sh_rest)

    def clamp(self, extent: float) -> int:
        """Reset runaway rows and clamp parameters; returns the number of rows that were reset.

        `extent`: camera extent, training units.
        """
        count = ct.c_int64()
        self._call("clamp", extent, ct.byref(count))
        return count.value

    def noise(self, weight: float, *, seed: int, step: int, stream: int) -> None:
        """Move faint splats by covariance @ normal numbers times `weight`; the keys are those of
        `random_numbers.normal_rows`."""
        self._call("noise", weight, ct.byref(RandomStruct(seed, step, stream)))

    def morton_order(
        self, low: np.ndarray, high: np.ndarray, rows: np.ndarray | None = None
    ) -> np.ndarray:
        """Sort rows along a Morton curve through their means.

        Args:
            low: [3], lower corner of the grid.
            high: [3], upper corner.
            rows: [M] int64; None: all.

        Returns:
            [M] uint32, places in `rows`; those of one cell keep their order.
        """
        order = np.empty(len(self) if rows is None else len(rows), np.uint32)
        if len(order):
            found = optional("rows", rows, order.shape, INT64)
            corners = [np.ascontiguousarray(corner, np.float32) for corner in (low, high)]
            at = [address("corner", corner, (3,)) for corner in corners]
            self._call("morton", found, len(order), *at, order.ctypes.data)
        return order

    def drop_moments(self) -> None:
        """Free moments and accumulated gradients."""
        self._call("drop_moments")
        self.has_moments = False

    def _columns(
        self,
        verb: str,
        table: int,
        components: tuple[int, int],
        rows: np.ndarray | None,
        begin: int,
        values: np.ndarray,
    ) -> None:
        columns = self._columns_struct(table, components, rows, begin, len(values))
        found = address("values", values, (len(values), components[1]))
        self._call(verb, ct.byref(columns), found)

    def _columns_struct(
        self,
        table: int,
        components: tuple[int, int],
        rows: np.ndarray | None,
        begin: int,
        count: int,
    ) -> ct.Structure:
        found = optional("rows", rows, (count,), INT64)
        return header.GpuColumnsStruct(table, *components, found, begin, count)

    def _call(self, verb: str, *values: Any) -> None:
        self._raster.call(getattr(self._lib, f"gs_gpu_model_{verb}"), *values, handle=self.handle)
