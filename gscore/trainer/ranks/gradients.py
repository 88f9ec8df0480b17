"""The gradients and counts of a batch: each rank has those of one photo, all get the mean."""

import torch
from torch import Tensor

from ...raster.memory import empty, zeros
from ...raster.packing import Table, unpack_rows
from ...splats import PARAMETERS
from ..rows.model import Model
from .sums import RowSums
from .team import Team


class BatchGradients:
    """Takes the gradients of this rank's photo, and makes those of the batch of them."""

    def __init__(self, team: Team) -> None:
        self._team = team
        self._sums = RowSums(team)
        self._v_shN = empty(0)

    def into(self, model: Model) -> dict[str, Tensor]:
        """Where the gradients of this rank's photo go, as `model.grads`: those of shN beside the
        model's, where they have gathered over the steps before."""
        shN = model.grads["shN"]
        if self._v_shN.shape != shN.shape:
            self._v_shN = empty(*shN.shape)
        return model.grads | {"shN": self._v_shN.zero_()}

    @staticmethod
    def counters(model: Model) -> dict[str, Tensor]:
        """Zeros in place of what a strategy counts for each splat, [N] float32 by name."""
        found = {name: rows for name, rows in model.rows.items() if rows.dtype == torch.float32}
        return {name: torch.zeros_like(rows) for name, rows in found.items()}

    def add_up(
        self,
        model: Model,
        *,
        radii: Tensor,
        counters: dict[str, Tensor],
        photos: int,
        threads: int,
    ) -> Tensor:
        """Put the mean gradient of all photos into `model.grads`, and add all counts to
        `model.rows`.

        Args:
            model: Its gradients, but for those of shN, and what lies in `into`, are those of this
                rank's photo. Ranks from `photos` on have nothing to add.
            radii: [N] int32, above 0 where this rank's photo showed a splat.
            counters: What the strategy counted in this rank's photo.
            photos: How many there are in this batch.
            threads: 0: all cores.

        Returns:
            [N] int32, 1 where some photo showed a splat.
        """
        if len(model) == 0:
            return radii
        rows = (radii > 0).nonzero().flatten()
        if self._team.rank >= photos:
            rows = rows[:0]
        grads = {name: model.grads[name] for name in PARAMETERS}
        mine = (grads | {"shN": self._v_shN} | counters).values()
        found = self._sums(rows, [part for part in mine if part.numel()], threads=threads)
        for name, grad in grads.items():
            if name != "shN":
                grad.zero_()
        sums = [Table(grad, name == "shN", photos) for name, grad in grads.items()]
        sums += [Table(model.rows[name], adds=True) for name in counters]
        shown = zeros(len(model), dtype=torch.int32)
        for part in found:
            unpack_rows([sum_ for sum_ in sums if sum_.data.numel()], part, threads=threads)
            shown[part[:, 0].to(torch.int64)] = 1
        return shown
