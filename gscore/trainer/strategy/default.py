"""Adaptive density control of the 3DGS paper: clone, split, prune and reset (Kerbl et al. 2023)."""

import math
from collections.abc import Iterator, Mapping

import numpy as np
import torch

from ...config import Doubling, TrainConfig
from ...engine.base import RowEdit
from ...engine.random import gaussian
from ...engine.rotation import rotate, undirected
from ..schedule.plan import Plan
from .base import Read, Within
from .relocation import logit

SPLIT_COUNT = 2
"""Number of splats that replace a split one (Kerbl et al. 2023, section 5.2)."""
SPLIT_SHRINK = 1.6
"""Divisor of the scales of split splats."""
HALF_OFFSET, HALF_LENGTH, HALF_WIDTH, HALF_OPACITY = 0.7, 0.5, 0.85, 0.6
"""Halves of a splat relative to it: distance from its centre and length along the longest axis,
width along the others, and opacity (factors of Deng et al. 2024; the distance was measured)."""


def split(
    params: Mapping[str, torch.Tensor], index: torch.Tensor, generator: torch.Generator
) -> dict[str, torch.Tensor]:
    """Return means and scales of the splats that replace the rows `index`, [M], in a split: drawn
    from their Gaussians, with scales divided by 1.6.

    Args:
        params: Raw parameters of all splats; means, quats and scales are read.
        index: Rows.
        generator: Source of the draw.

    Returns:
        SPLIT_COUNT * M rows by name.
    """
    means, quats, scales = (
        params[name][index].repeat(SPLIT_COUNT, 1) for name in ("means", "quats", "scales")
    )
    noise = gaussian(tuple(means.shape), generator)
    return {
        "means": means + rotate(quats, scales.exp() * noise),
        "scales": scales - math.log(SPLIT_SHRINK),
    }


def halve(params: Mapping[str, torch.Tensor], index: torch.Tensor) -> dict[str, torch.Tensor]:
    """Return means, scales and opacities of two halves of each row `index`, [M], next to each other
    along its longest axis. Together they render close to the splat, so that little must be trained
    again (Deng et al. 2024, Efficient Density Control for 3D Gaussian Splatting).

    Returns:
        SPLIT_COUNT * M rows by name: first all of one side, then of the other.
    """
    means, quats, scales, opacities = (
        params[name][index] for name in ("means", "quats", "scales", "opacities")
    )
    longest = torch.nn.functional.one_hot(scales.argmax(dim=1), 3).bool()
    offset = rotate(quats, HALF_OFFSET * scales.exp() * longest)
    length, width = (scales + math.log(f) for f in (HALF_LENGTH, HALF_WIDTH))
    scales = torch.where(longest, length, width)
    opacities = torch.logit(HALF_OPACITY * torch.sigmoid(opacities), eps=1e-6)
    halves = {"means": means, "scales": scales, "opacities": opacities}
    halves = {name: torch.cat([t, t]) for name, t in halves.items()}
    halves["means"] += torch.cat([offset, -offset])
    return halves


RESET_OPACITY = 0.01
"""Ceiling of all opacities at a reset."""
_COUNTERS = ("grad2d", "views")
"""Sum of the screen-space gradients, and number of views, of each splat."""

_LARGE = 0.01
"""Size above which `clone-split` splits a splat instead of cloning it, extents (Kerbl et al.)."""


class DefaultStrategy:
    """Clones or splits splats with large screen-space gradients, prunes transparent and huge ones.

    The criterion is |dL / d mean2d| in normalised image coordinates (2 per image side), averaged
    over the views that drew the splat. Under a cap, splats with the largest gradients come first.
    """

    counters = _COUNTERS
    opacity_reg = scale_reg = 0.0

    def __init__(self, config: TrainConfig, plan: Plan, *, extent: float, may_grow: Within) -> None:
        self._config = config
        self._plan = plan
        self._extent = extent
        self._may_grow = may_grow

    def observes_at(self, step: int) -> bool:
        return step <= self._plan.refine_stop

    def noise_at(self, means_lr: float) -> float:
        return 0.0

    def refine(
        self, read: Read, *, step: int, cap: int, generator: torch.Generator
    ) -> Iterator[RowEdit]:
        if self._plan.refines_at(step):
            yield from self._refine(read, step, cap, generator)
        if self._plan.resets_at(step):
            lowered = np.minimum(read("opacities"), np.float32(logit(RESET_OPACITY)))
            yield RowEdit(values={"opacities": lowered}, forget=("opacities",))

    def _refine(
        self, read: Read, step: int, cap: int, generator: torch.Generator
    ) -> Iterator[RowEdit]:
        names = ("means", "quats", "scales", "opacities")
        params = {name: torch.from_numpy(read(name)) for name in names}
        grad2d, views = (torch.from_numpy(read(name)) for name in _COUNTERS)
        gradients = grad2d / views.clamp_min(1)
        pruned = self._to_prune(params, step)
        grow = gradients >= self._plan.grow_grad
        grow &= ~pruned & torch.from_numpy(self._may_grow(params["means"].numpy()))
        room = cap - len(gradients) + int(pruned.sum())
        grow = _strongest(grow, gradients, max(room, 0))
        parents, changes, replaced = self._doubled(params, grow, generator)
        new = {name: p[parents] for name, p in params.items()} | changes
        healthy = (~self._to_prune(new, step)).nonzero().flatten()
        keep = ~pruned
        keep[replaced] = False
        kept = keep.nonzero().flatten()
        if len(kept) + len(healthy) == 0:  # an empty model cannot recover
            return
        yield RowEdit(
            keep=kept.numpy(),
            morton=True,
            parents=parents[healthy].numpy(),
            changes={name: rows[healthy].numpy() for name, rows in changes.items()},
        )
        count = len(kept) + len(healthy)
        yield RowEdit(values={name: np.zeros(count, np.float32) for name in _COUNTERS})

    def _doubled(
        self, params: dict[str, torch.Tensor], grow: torch.Tensor, generator: torch.Generator
    ) -> tuple[torch.Tensor, dict[str, torch.Tensor], torch.Tensor]:
        """Return the new splats for the rows `grow`, [N] bool: their parents, [A], parameters that
        differ from those of the parents, and the rows, [M], that they replace."""
        if self._config.doubling is Doubling.LONG_AXIS:
            rows = grow.nonzero().flatten()
            return rows.repeat(SPLIT_COUNT), halve(params, rows), rows
        size = params["scales"].amax(dim=1)  # log
        large = size > _log(_LARGE * self._extent)
        clone, divide = (grow & ~large).nonzero().flatten(), (grow & large).nonzero().flatten()
        children = split(params, divide, generator)
        changes = {name: torch.cat([params[name][clone], rows]) for name, rows in children.items()}
        return torch.cat([clone, divide.repeat(SPLIT_COUNT)]), changes, divide

    def _to_prune(self, params: dict[str, torch.Tensor], step: int) -> torch.Tensor:
        """Return [N] bool: splats that are too transparent, too large after the first opacity
        reset, or have a quaternion that is too short."""
        config, opacities = self._config, params["opacities"]
        pruned = ~(opacities >= logit(max(config.prune_opacity, 1e-6)))  # NaN too
        if self._plan.reset_every and step > self._plan.reset_every:
            size = params["scales"].amax(dim=1)
            pruned |= size > _log(config.prune_scale * self._extent)
        return pruned | undirected(params["quats"])


def _log(value: float) -> float:
    return math.log(value) if value > 0 else -math.inf


def _strongest(mask: torch.Tensor, score: torch.Tensor, count: int) -> torch.Tensor:
    """Return `mask`, [N], with at most `count` entries left: those with the largest score; ties in
    order of the rows."""
    chosen = mask.nonzero().flatten()
    if len(chosen) <= count:
        return mask
    order = np.argsort(-score[chosen].numpy(), kind="stable")[:count]
    out = torch.zeros_like(mask)
    out[chosen[torch.from_numpy(order)]] = True
    return out
