"""Data parallelism: CPU engines on several ranks, each with one photo of a step."""

from collections.abc import Mapping, Sequence

import numpy as np
import torch

from ...engine import base
from ...engine.base import EngineModel, StepNumbers, StepRequest
from ...engine.cpu.engine import CpuEngine
from ...engine.cpu.model import CpuModel, Moments, accumulated_of
from . import batch_losses
from .batch_gradients import BatchGradients
from .consistency import crc_of
from .process_group import ProcessGroup


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
            slopes = self._group.all_gather(self._slopes_of(request, drawn.loss))
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
