"""The gradients and counts of a batch: each rank has those of one photo, all get the mean."""

import torch
from torch import Tensor

from ...raster.memory import zeros
from ...splats import PARAMETERS
from ..rows.model import Model
from .sums import sum_rows
from .team import Team


def counters_of(model: Model) -> dict[str, Tensor]:
    """Zeros in place of what a strategy counts for each splat, [N] float32 by name."""
    found = {name: rows for name, rows in model.rows.items() if rows.dtype == torch.float32}
    return {name: torch.zeros_like(rows) for name, rows in found.items()}


def add_up(
    team: Team,
    model: Model,
    *,
    radii: Tensor,
    v_shN: Tensor,
    counters: dict[str, Tensor],
    photos: int,
) -> Tensor:
    """Put the mean gradient of all photos into `model.grads`, and add all counts to `model.rows`.

    Args:
        team: Ranks below `photos` have looked at a photo each; the others have nothing to add.
        model: Its gradients are those of this rank's photo, but for shN, which have gathered over
            the steps before.
        radii: [N] int32, above 0 where this rank's photo showed a splat.
        v_shN: As shN: the gradient of this rank's photo.
        counters: What the strategy counted in this rank's photo.
        photos: How many there are in this batch.

    Returns:
        [N] int32, 1 where some photo showed a splat.
    """
    rows = (radii > 0).nonzero().flatten()
    if team.rank >= photos:
        rows = rows[:0]
    blocks = {name: model.grads[name] for name in PARAMETERS} | {"shN": v_shN} | counters
    flat = [block[rows].reshape(len(rows), _width(block)) for block in blocks.values()]
    values = torch.cat(flat, dim=1)
    rows, sums = sum_rows(team, rows, values)
    parts = sums.split([_width(block) for block in blocks.values()], dim=1)
    for (name, block), part in zip(blocks.items(), parts, strict=True):
        part = part.reshape(len(rows), *block.shape[1:])
        if name in counters:
            model.rows[name][rows] += part
        elif name == "shN":
            model.grads[name][rows] += part / photos
        else:
            model.grads[name].zero_()
            model.grads[name][rows] = part / photos
    shown = zeros(len(model), dtype=torch.int32)
    shown[rows] = 1
    return shown


def _width(block: Tensor) -> int:
    return block[0].numel() if len(block) else 1
