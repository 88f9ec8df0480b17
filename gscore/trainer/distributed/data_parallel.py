"""Data parallelism: CPU engines on several ranks, each with one photo of a step."""

import weakref
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ...engine import base
from ...engine.base import EngineModel, ShUpdate, StepNumbers, StepRequest
from ...engine.cpu.engine import CpuEngine
from ...engine.cpu.model import ACCUMULATED, CpuModel, Moments, accumulated_of
from ...raster.memory import zeros
from ...raster.row_packing import Table, pack_rows, unpack_rows, widths_of
from ...splats import PARAMETERS
from . import batch_losses
from .consistency import crc_of
from .process_group import ProcessGroup, ScratchBuffer


class SortedRows(NamedTuple):
    """Rows of a rank."""

    rows: Tensor
    """[M] int64; for more than two ranks, sorted by the rank that adds them."""
    sizes: list[int]
    """Number of rows sent to each rank."""


class RowSums:
    """Sums of sparse rows of large tables over ranks; keeps its memory between calls.

    Row i belongs to rank i modulo the number of ranks: that rank adds the values of all ranks,
    starting with rank 0, so that the same ranks give the same bits, and sends the sum to all. Two
    ranks exchange all their rows instead, which is no more traffic. Rows that no rank has are not
    sent.
    """

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


class SharedModel(CpuModel):
    """A model that all ranks have, with the state of its batches."""

    batch: BatchGradients

    def widen_sh(self, degree: int) -> None:
        """Like `CpuModel.widen_sh`."""
        if self.sh_degree < degree:
            super().widen_sh(degree)
            self.batch.forget()

    def save(self) -> dict[str, np.ndarray]:
        """Like `CpuModel.save`, with the accumulated gradients of other ranks after `collect`."""
        return super().save() | {name: t.numpy() for name, t in self.batch.tensors().items()}


class DataParallelEngine(CpuEngine):
    """CPU engine of one rank: gradients are averaged over the photos of all ranks."""

    def __init__(self, group: ProcessGroup, *, threads: int = 0) -> None:
        super().__init__(threads=threads)
        self._group = group

    def _new(
        self,
        tensors: Mapping[str, torch.Tensor],
        counters: Sequence[str],
        moments: Mapping[str, Moments] | None = None,
    ) -> SharedModel:
        model = SharedModel(tensors, moments, counters=counters, threads=self._threads)
        model.batch = BatchGradients(self._group)
        return model

    def _accumulated(self, saved: Mapping[str, torch.Tensor]) -> torch.Tensor | None:
        return accumulated_of(saved, self._group.rank, self._group.size)

    def step(self, model: CpuModel, request: StepRequest) -> base.Pending:
        """Take a step with the photos of all ranks.

        Raises:
            OtherRankError: another rank cannot read its photo; nothing was changed.
        """
        assert isinstance(model, SharedModel)
        batch, count = model.batch, 1 + len(request.others)
        drawn = self._draw_step(model, request)
        found = batch_losses.of_all(
            self._group,
            drawn.loss.value,
            drawn.loss.mse,
            cost=self._rasterizer.stats()["entries"],
            photos=count,
            mark=float(crc_of(model.params)) if request.compare else 0.0,
            sizes=batch.sizes(self._rasterizer.radii, count),
        )
        batch.receive(found.sizes)
        losses = list(zip(found.values, found.errors, strict=True))
        lost_rows, skipped = self._checked(model, request, drawn, losses)
        numbers = StepNumbers(
            step=request.step,
            loss=sum(found.values) / count,
            mse=sum(found.errors) / count,
            slopes=np.zeros((count, 19)),
            lost_rows=lost_rows,
            skipped=skipped,
            seconds=drawn.timer.seconds,
            costs=tuple(found.costs),
        )
        if skipped:
            return numbers
        v_means2d = self._backward(request, drawn, batch.into(model, count))
        slopes = numbers.slopes
        if request.learn_gain or request.learn_pose:
            slopes = self._group.all_gather(self._slopes_of(request, drawn.loss))[:count]
        counters = batch.counters(model)
        self._observe(request, counters, v_means2d)
        radii = batch.add_up(model, counters=counters, photos=count, threads=self._threads)
        batch.sum_harmonics(model, request.sh_update, threads=self._threads)
        bad_rows = self._update(model, request, radii)
        drawn.timer.lap("learn")
        return numbers._replace(slopes=slopes, bad_rows=bad_rows, raster=drawn.timer.raster)

    def collect(self, models: Sequence[EngineModel]) -> None:
        """Collect on rank 0 the state that only other ranks have; all ranks call this."""
        for model in models:
            if isinstance(model, SharedModel) and not model.batch.complete:
                model.batch.collect(model)

    def collected(self, models: Sequence[EngineModel]) -> bool:
        """True if rank 0 has the whole state of a checkpoint; equal on all ranks."""
        return all(model.batch.complete for model in models if isinstance(model, SharedModel))
