"""Batch gradients and counters: each rank adds those of one photo, all ranks get the mean."""

import weakref
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ...engine.base import ShUpdate
from ...engine.cpu.model import ACCUMULATED, CpuModel
from ...raster.memory import zeros
from ...raster.row_packing import Table, pack_rows, unpack_rows, widths_of
from ...splats import PARAMETERS
from .process_group import ProcessGroup, ScratchBuffer


class SortedRows(NamedTuple):
    """Rows of a rank."""

    rows: Tensor
    """[M] int64; for more than two ranks, sorted by the rank that adds them."""
    sizes: list[int]
    """Number of rows sent to each rank."""


class RowSums:
    """Sums of sparse rows of large tables over ranks; keeps its memory between calls."""

    def __init__(self, group: ProcessGroup) -> None:
        self._group = group
        self._mine, self._given, self._sums, self._own, self._all = (
            ScratchBuffer() for _ in range(5)
        )

    def sorted(self, rows: Tensor) -> "SortedRows":
        """Sort this rank's rows, [M] int64 and unique, by the rank that adds them."""
        rank, size = self._group.rank, self._group.size
        if size == 2:
            return SortedRows(rows, [0 if other == rank else len(rows) for other in range(size)])
        owner = rows % size
        parts = [rows[owner == other] for other in range(size)]
        return SortedRows(torch.cat(parts), [len(part) for part in parts])

    def __call__(
        self,
        mine: "SortedRows",
        tables: Sequence[Table],
        *,
        all_sizes: np.ndarray | None = None,
        threads: int = 0,
    ) -> list[Tensor]:
        """Sum the rows over all ranks.

        Args:
            mine: Rows of this rank.
            tables: K numbers per row in total; tables with a divisor are divided by it first.
            all_sizes: [size, size] `sizes` of each rank, if known; None: the ranks exchange them.
            threads: 0: all cores.

        Returns:
            Parts, [R, 1 + K] int32, of rows that some rank has, in the format of
            `raster.row_packing.unpack_rows`: added in order they are the sums. Equal on all ranks,
            and valid until the next call.
        """
        group, size = self._group, self._group.size
        width = 1 + widths_of([table.data for table in tables])
        packed = self._mine.of(len(mine.rows), width)
        pack_rows(tables, mine.rows, packed, threads=threads)
        if size == 2:
            return group.rows(packed, self._given, all_sizes=all_sizes)
        given = group.all_to_all(packed, mine.sizes, self._given, all_sizes=all_sizes)
        places = [part[:, 0] // size for part in given]
        # Rows need not be sorted.
        count = max((int(at.max()) + 1 for at in places if len(at)), default=0)
        sums = self._sums.of(count, width - 1).view(torch.float32).zero_()
        had = zeros(count, dtype=torch.bool)
        for at, part in zip(places, given, strict=True):
            part[:, 0] = at
            unpack_rows([Table(sums, adds=True)], part, threads=threads)
            had[at.to(torch.int64)] = True
        at = had.nonzero().flatten()
        own = self._own.of(len(at), width)
        pack_rows([Table(sums)], at, own, threads=threads)
        own[:, 0] = at * size + group.rank
        return group.rows(own, self._all)


class BatchGradients:
    """Averages the gradients of a batch over the ranks, which render one photo each.

    The gradients of shN, three quarters of all numbers, accumulate on each rank and are summed only
    when shN takes a step; until then they differ between ranks.
    """

    def __init__(self, group: ProcessGroup) -> None:
        self._group = group
        self._sums = RowSums(group)
        self.complete = False
        """True if rank 0 has the accumulated gradients of all ranks; equal on all ranks."""
        self._others: list[Tensor] = []
        self._accumulated = torch.zeros(0, dtype=torch.bool, device="cpu")
        """[N]: non-zero rows of the shN gradient."""
        self._source: weakref.ref[Tensor] | None = None
        """The gradient tensor that `_accumulated` describes."""
        self._visible = torch.zeros(0, dtype=torch.bool, device="cpu")
        """[N]: splats visible in this rank's photo."""
        self._rows = self._sums.sorted(self._visible.nonzero().flatten())
        self._all_sizes: np.ndarray | None = None

    def sizes(self, radii: Tensor, photos: int) -> list[int]:
        """Return the number of gradient rows that this rank will send to each rank.

        Args:
            radii: [N] int32, above 0 for splats visible in this rank's photo.
            photos: Number of photos in this batch; ranks from this number on send no rows.
        """
        self._visible = radii > 0
        if self._group.rank >= photos:
            self._visible.zero_()
        if len(self._accumulated) == len(radii):
            self._accumulated |= self._visible
        self._rows = self._sums.sorted(self._visible.nonzero().flatten())
        return self._rows.sizes

    def receive(self, sizes: np.ndarray) -> None:
        """Store the [size, size] `sizes` of all ranks for `add_up`."""
        self._all_sizes = sizes

    def into(self, model: CpuModel, photos: int) -> dict[str, Tensor]:
        """Return the tensors that receive the gradients of this rank's photo, as `model.grads`.

        Where there are fewer `photos` than ranks, the remaining ranks render another rank's photo
        and discard its shN gradient."""
        if self._group.rank < photos:
            return model.grads
        return model.grads | {"shN": torch.zeros_like(model.grads["shN"])}

    @staticmethod
    def counters(model: CpuModel) -> dict[str, Tensor]:
        """Return zeroed counters of a strategy for one batch, [N] float32 by name."""
        counts = {name: rows for name, rows in model.rows.items() if rows.dtype == torch.float32}
        return {name: torch.zeros_like(rows) for name, rows in counts.items()}

    def add_up(
        self,
        model: CpuModel,
        *,
        counters: dict[str, Tensor],
        photos: int,
        threads: int,
    ) -> Tensor:
        """Average the gradients over all photos into `model.grads`, except shN, and add all
        counters to `model.rows`. Call `receive` first.

        Args:
            model: Holds the gradients of this rank's photo.
            counters: Counters of the strategy for this rank's photo.
            photos: Number of photos in this batch.
            threads: 0: all cores.

        Returns:
            [N] int32, 1 for splats visible in some photo.
        """
        visible = self._visible.to(torch.int32)
        if len(model) == 0:
            return visible
        self._note_accumulated(model.grads["shN"])
        grads = [model.grads[name] for name in PARAMETERS if name != "shN"]
        tables = [Table(grad, adds=True, divisor=photos) for grad in grads]
        tables += [Table(counter, adds=True) for counter in counters.values()]
        parts = self._sums(self._rows, tables, all_sizes=self._all_sizes, threads=threads)
        # The sum of two numbers does not depend on their order, so with two ranks each keeps its
        # own rows and adds the other's, unless it rendered the other's photo.
        if self._group.size == 2 and self._group.rank < photos:
            parts = [parts[1 - self._group.rank]]
        else:
            for table in tables:
                table.data.zero_()
        for part in parts:
            unpack_rows(tables, part, marks=visible, threads=threads)
        for name, counter in counters.items():
            model.rows[name] += counter
        return visible

    def sum_harmonics(self, model: CpuModel, does: ShUpdate, *, threads: int) -> None:
        """Sum the accumulated shN gradients of all ranks into `model.grads`, if shN takes a step.

        Args:
            model: CpuModel of this rank.
            does: Update of shN in this step.
            threads: 0: all cores.
        """
        self._others = []
        grad = model.grads["shN"]
        if grad.numel() == 0 or does is not ShUpdate.STEP:
            self.complete = False
            return
        rows = self._accumulated.nonzero().flatten()
        table = Table(grad, adds=True)
        parts = self._sums(self._sums.sorted(rows), [table], threads=threads)
        if self._group.size == 2:
            parts = [parts[1 - self._group.rank]]
        else:
            grad.zero_()
        for part in parts:
            unpack_rows([table], part, threads=threads)
        self._accumulated.zero_()
        self.complete = True

    def _note_accumulated(self, grad: Tensor) -> None:
        """Find the non-zero rows of a new shN gradient tensor; for the same tensor as before,
        `sizes` has noted the splats visible since the last step."""
        if self._source is not None and self._source() is grad:
            return
        self._source = weakref.ref(grad)
        self._accumulated = torch.from_numpy(np.any(grad.numpy(), axis=(1, 2)))

    def collect(self, model: CpuModel) -> None:
        """Gather the accumulated gradients on rank 0; all ranks call this unless `complete`."""
        self._others = self._group.to_first(model.grads["shN"])
        self.complete = True

    def forget(self) -> None:
        """Discard the collected gradients, because the model's shape changed."""
        self.complete, self._others = False, []

    def tensors(self) -> dict[str, Tensor]:
        """Return the accumulated gradients of the other ranks, by their name in checkpoints."""
        return {f"{ACCUMULATED}/{rank}": part for rank, part in enumerate(self._others, 1)}
