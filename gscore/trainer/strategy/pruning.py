"""Pruning by photos, masks and free space, in addition to that of the strategy."""

from collections.abc import Callable, Iterable, Iterator
from typing import Protocol

import numpy as np
import torch

from ...config import TrainConfig
from ...engine.base import Contribution, RowEdit
from ...raster.memory import zeros
from ..model.checkpoint_schema import as_int
from ..schedule.plan import Plan
from .base import Read

_CROWD = 0.2
"""Share of all splats in a free space above which it is not considered free."""


class Space(Protocol):
    """A free space."""

    def contains(self, means: torch.Tensor) -> torch.Tensor:
        """Return [N] bool: `means`, [N, 3] in the training frame, in the space."""
        ...


class Emptied:
    """A free space from which splats are removed, unless too many are in it at once."""

    def __init__(self, space: Space | None) -> None:
        self._space = space
        self.count = 0
        """Number of splats removed so far."""
        self.crowded = False
        """True if too many splats were in it at once, so that it is no longer emptied."""

    def due(self, means: torch.Tensor) -> torch.Tensor | None:
        """Return the splats to remove, [N] bool; None: none."""
        if self._space is None or self.crowded:
            return None
        inside = self._space.contains(means)
        count = int(inside.sum())
        self.crowded = count > _CROWD * len(means)
        if count == 0 or self.crowded:
            return None
        self.count += count
        return inside

    def restore(self, state: dict[str, int | bool], cleared: str, crowded: str) -> None:
        """Restore the values of `state` under these keys, if present."""
        self.count = as_int(cleared, state.get(cleared, 0))
        self.crowded = state.get(crowded, False) is True


class Pruner:
    """Prunes splats in free space, masked splats, and splats with the least contribution.

    Each method yields the edits that are due after a step, each to be applied before the next.
    """

    def __init__(
        self,
        config: TrainConfig,
        around: Space,
        path: Space,
        *,
        masks_hide: bool,
        sky: Space | None = None,
        guided: Space | None = None,
    ) -> None:
        """Create a pruner.

        Args:
            config: The options.
            around: Free space around cameras.
            path: Free space between cameras.
            masks_hide: Whether masks exclude pixels from the loss.
            sky: Free space in front of the sky.
            guided: Free space of a guide mesh.
        """
        self._config = config
        self._masks_hide = masks_hide
        self.around = Emptied(around)
        """Free space around cameras."""
        self.path = Emptied(path)
        """Free space between cameras."""
        self.sky = Emptied(sky)
        """Free space in front of the sky."""
        self.guided = Emptied(guided)
        """Free space in front of a guide mesh."""

    def prune_free_space(self, read: Read, plan: Plan, step: int) -> Iterator[RowEdit]:
        """Remove splats in free space: at and between cameras, in front of a guide mesh and of the
        sky."""
        spaces = (self.around, self.path, self.guided) if plan.prunes_free_space_at(step) else ()
        for space in (*spaces, *([self.sky] if plan.prunes_free_sky_at(step) else [])):
            rows = space.due(torch.from_numpy(read("means")))
            if rows is not None:
                yield RowEdit(keep=np.flatnonzero(~rows.numpy()))

    def prune_masked(
        self, count: int, weights: Callable[[], Iterable[Contribution]], plan: Plan, step: int
    ) -> Iterator[RowEdit]:
        """Remove splats with most of their weight in masked pixels.

        Args:
            count: Number of splats.
            weights: Returns the contributions to all training views.
            plan: Plan of the run.
            step: Last step.
        """
        share = self._config.hidden_share
        if share == 0 or not self._masks_hide or not plan.prunes_masked_at(step):
            return
        hidden = mostly_masked(weights(), count, share=share).numpy()
        if 0 < hidden.sum() < count:
            yield RowEdit(keep=np.flatnonzero(~hidden))

    def prune_least(
        self,
        count: int,
        weights: Callable[[], Iterable[Contribution]],
        plan: Plan,
        step: int,
        *,
        pruned: int,
    ) -> Iterator[RowEdit]:
        """Remove the splats with the least contribution if the plan has fewer splats; `pruned`:
        number of those removed before. The other arguments are those of `prune_masked`."""
        surplus = plan.surplus_at(step, count, pruned)
        if surplus:
            least = lowest_rows(max_contribution(weights(), count), surplus)
            yield RowEdit(keep=np.flatnonzero(~least.numpy()))

    def state(self) -> dict[str, int | bool]:
        """State of the pruning, as JSON values."""
        return {
            "cleared": self.around.count,
            "crowded": self.around.crowded,
            "path_cleared": self.path.count,
            "path_crowded": self.path.crowded,
            "sky_cleared": self.sky.count,
            "sky_crowded": self.sky.crowded,
            "guide_cleared": self.guided.count,
            "guide_crowded": self.guided.crowded,
        }

    def restore(self, state: dict[str, int | bool]) -> None:
        """Restore the values of `state`; other keys are ignored.

        Raises:
            ValueError, KeyError: they are invalid.
        """
        self.around.restore(state, "cleared", "crowded")
        self.path.restore(state, "path_cleared", "path_crowded")
        self.sky.restore(state, "sky_cleared", "sky_crowded")
        self.guided.restore(state, "guide_cleared", "guide_crowded")


def max_contribution(weights: Iterable[Contribution], count: int) -> torch.Tensor:
    """Return the largest `kept` weight of each of `count` splats over all views, [N] float32, px.

    The maximum keeps splats that a single view needs; the sum would favour the background, which
    all views show. Pruning half of the splats by the sum cost 0.1 to 0.2 dB more on plush.
    """
    most = zeros(count)
    for kept, _ in weights:
        torch.maximum(most, torch.from_numpy(kept), out=most)
    return most


def mostly_masked(weights: Iterable[Contribution], count: int, *, share: float) -> torch.Tensor:
    """Return [N] bool: splats with less than `share` of their weight in unmasked pixels.

    No photo constrains their colours, and they occlude splats in other photos.
    """
    kept, whole = zeros(count), zeros(count)
    for of_kept, of_whole in weights:
        kept += torch.from_numpy(of_kept)
        whole += torch.from_numpy(of_whole)
    return kept < share * whole


def lowest_rows(weights: torch.Tensor, count: int) -> torch.Tensor:
    """Return [N] bool: the `count` smallest of `weights`, [N]; ties in order of the rows."""
    out = zeros(len(weights), dtype=torch.bool)
    out[torch.sort(weights, stable=True).indices[:count]] = True
    return out
