"""Batch gradients and counters: every rank has those of one photo, all ranks get the mean."""

import itertools
import weakref
from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from ...raster.packing import Table, unpack_rows
from ...splats import PARAMETERS
from ..model.model import Model, ShUpdate
from .process_group import ProcessGroup
from .row_sums import RowSums

_GATHERED = "gathered/shN"


class BatchGradients:
    """Makes the gradients of a batch of those of each rank's photo.

    Those of the higher SH coefficients, three quarters of all numbers, gather on each rank, and are
    added up only for a step of theirs. So the ranks' models differ in what has gathered.
    """

    def __init__(self, team: ProcessGroup) -> None:
        self._team = team
        self._sums = RowSums(team)
        self.complete = False
        """Whether rank 0 has all that `tensors` needs; the same on all ranks."""
        self._others: list[Tensor] = []
        self._gathered = torch.zeros(0, dtype=torch.bool, device="cpu")
        self._gathers: weakref.ref[Tensor] | None = None
        self._shown = torch.zeros(0, dtype=torch.bool, device="cpu")
        """[N]: what this rank's photo shows."""
        self._rows = self._sums.sorted(self._shown.nonzero().flatten())
        self._told: np.ndarray | None = None

    def sizes(self, radii: Tensor, photos: int) -> list[int]:
        """How many rows this rank will give to each rank of what its photo shows.

        Args:
            radii: [N] int32, above 0 where it shows a splat.
            photos: How many there are in this batch. Ranks from there on have nothing to add.
        """
        self._shown = radii > 0
        if self._team.rank >= photos:
            self._shown.zero_()
        if len(self._gathered) == len(radii):
            self._gathered |= self._shown
        self._rows = self._sums.sorted(self._shown.nonzero().flatten())
        return self._rows.sizes

    def receive(self, sizes: np.ndarray) -> None:
        """[size, size] `sizes` of each rank."""
        self._told = sizes

    def into(self, model: Model, photos: int) -> dict[str, Tensor]:
        """Where the gradients of this rank's photo go, as `model.grads`. A rank that looks at
        another's photo, since there are fewer `photos` than ranks, keeps nothing of it."""
        if self._team.rank < photos:
            return model.grads
        return model.grads | {"shN": torch.zeros_like(model.grads["shN"])}

    @staticmethod
    def counters(model: Model) -> dict[str, Tensor]:
        """Zeros in place of what a strategy counts for each splat, [N] float32 by name."""
        found = {name: rows for name, rows in model.rows.items() if rows.dtype == torch.float32}
        return {name: torch.zeros_like(rows) for name, rows in found.items()}

    def add_up(
        self,
        model: Model,
        *,
        counters: dict[str, Tensor],
        photos: int,
        threads: int,
    ) -> Tensor:
        """Put the mean gradient of all photos into `model.grads`, but for those of shN, and add all
        counts to `model.rows`. All have told their `sizes` before.

        Args:
            model: Its gradients are those of this rank's photo.
            counters: What the strategy counted in this rank's photo.
            photos: How many there are in this batch.
            threads: 0: all cores.

        Returns:
            [N] int32, 1 where some photo showed a splat.
        """
        shown = self._shown.to(torch.int32)
        if len(model) == 0:
            return shown
        self._note_gathered(model.grads["shN"])
        grads = [model.grads[name] for name in PARAMETERS if name != "shN"]
        tables = [Table(grad, adds=True, divisor=photos) for grad in grads]
        tables += [Table(counter, adds=True) for counter in counters.values()]
        found = self._sums(self._rows, tables, told=self._told, threads=threads)
        # Two numbers are the same sum either way round, so what is here already stays: of two
        # ranks, and unless what this one looked at is another's.
        if self._team.size == 2 and self._team.rank < photos:
            found = [found[1 - self._team.rank]]
        else:
            for table in tables:
                table.data.zero_()
        for part in found:
            unpack_rows(tables, part, marks=shown, threads=threads)
        for name, counter in counters.items():
            model.rows[name] += counter
        return shown

    def add_up_rest(self, model: Model, does: ShUpdate, *, threads: int) -> None:
        """Put into `model.grads` what has gathered for shN on all ranks, if these take a step.

        Args:
            model: Of this rank.
            does: What they do in this step.
            threads: 0: all cores.
        """
        self._others = []
        grad = model.grads["shN"]
        if grad.numel() == 0 or does is not ShUpdate.STEP:
            self.complete = False
            return
        rows = self._gathered.nonzero().flatten()
        table = Table(grad, adds=True)
        found = self._sums(self._sums.sorted(rows), [table], threads=threads)
        if self._team.size == 2:
            found = [found[1 - self._team.rank]]
        else:
            grad.zero_()
        for part in found:
            unpack_rows([table], part, threads=threads)
        self._gathered.zero_()
        self.complete = True

    def _note_gathered(self, grad: Tensor) -> None:
        """Which rows of the gradient of shN are not zero: those that this rank's photos have shown
        since the last step, as `sizes` has noted, unless another tensor came into its place."""
        if self._gathers is not None and self._gathers() is grad:
            return
        self._gathers = weakref.ref(grad)
        self._gathered = torch.from_numpy(np.any(grad.numpy(), axis=(1, 2)))

    def collect(self, model: Model) -> None:
        """Bring what has gathered to rank 0; all ranks call this where it is not complete."""
        self._others = self._team.to_first(model.grads["shN"])
        self.complete = True

    def forget(self) -> None:
        """What was collected is no longer of the model's shape."""
        self.complete, self._others = False, []

    def tensors(self) -> dict[str, Tensor]:
        """What has gathered on the other ranks, by the name that `gathered_of` looks for."""
        return {f"{_GATHERED}/{rank}": part for rank, part in enumerate(self._others, 1)}


def gathered_of(tensors: Mapping[str, Tensor], rank: int, size: int) -> Tensor | None:
    """What one of `size` ranks has gathered of the gradient of shN, of the tensors of a checkpoint;
    None: nothing. With as many ranks as wrote that, each gets its own; else the first gets all."""
    if _GATHERED not in tensors:
        return None
    names = itertools.takewhile(
        tensors.__contains__, (f"{_GATHERED}/{k}" for k in itertools.count(1))
    )
    parts = [tensors[_GATHERED], *(tensors[name] for name in names)]
    if len(parts) == size:
        return parts[rank]
    if rank:
        return torch.zeros_like(parts[0])
    for part in parts[1:]:
        parts[0] += part
    return parts[0]
