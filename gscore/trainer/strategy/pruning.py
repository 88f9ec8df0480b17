"""Pruning by photos, masks and free space, in addition to that of the strategy."""

from collections.abc import Callable, Iterable, Iterator
from typing import Protocol

import torch

from ...config import TrainConfig
from ...raster.training_rasterizer import TrainingRasterizer
from ..model.checkpoint_schema import as_int
from ..model.model import Model
from ..photos.image_pyramid import SizedView
from ..schedule.plan import Plan
from . import row_ops
from .contribution import Weights, lowest_rows, max_contribution, mostly_masked, weights_by_view

_CROWD = 0.2
"""Share of all splats in a free space above which it is not considered free."""


class Space(Protocol):
    """A free space."""

    def holds(self, means: torch.Tensor) -> torch.Tensor:
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
        inside = self._space.holds(means)
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

    Each method removes the splats that are due after a step and returns their number.
    """

    def __init__(
        self,
        config: TrainConfig,
        free_space: Space,
        rasterizer: TrainingRasterizer,
        shown: Callable[[], Iterable[SizedView]],
        *,
        masks_hide: bool,
        guided: Space | None = None,
    ) -> None:
        """Create a pruner.

        Args:
            config: The options.
            free_space: Free space around cameras.
            rasterizer: Its last rendered view becomes invalid.
            shown: Returns the training views at the size of the last step.
            masks_hide: Whether masks exclude pixels from the loss.
            guided: Free space of a guide mesh.
        """
        self._config = config
        self._rasterizer = rasterizer
        self._shown = shown
        self._masks_hide = masks_hide
        self.around = Emptied(free_space)
        """Free space around cameras."""
        self.guided = Emptied(guided)
        """Free space in front of a guide mesh."""

    def prune_free_space(self, model: Model, plan: Plan, step: int) -> int:
        """Remove splats in free space: around cameras and in front of a guide mesh."""
        if not plan.prunes_free_space_at(step):
            return 0
        before = len(model)
        for space in (self.around, self.guided):
            rows = space.due(model.params["means"])
            if rows is not None:
                self._remove(model, rows)
        return before - len(model)

    def prune_masked(self, model: Model, plan: Plan, step: int) -> int:
        """Remove splats with most of their weight in masked pixels."""
        share = self._config.hidden_share
        if share == 0 or not self._masks_hide or not plan.prunes_masked_at(step):
            return 0
        hidden = mostly_masked(self._weights(model), len(model), share=share)
        count = int(hidden.sum())
        if count == 0 or count == len(model):
            return 0
        self._remove(model, hidden)
        return count

    def prune_least(self, model: Model, plan: Plan, step: int, *, pruned: int) -> int:
        """Remove the splats with the least contribution if the plan has fewer splats; `pruned`:
        number of those removed before."""
        count = plan.surplus_at(step, len(model), pruned)
        if count == 0:
            return 0
        self._remove(model, lowest_rows(max_contribution(self._weights(model), len(model)), count))
        return count

    def state(self) -> dict[str, int | bool]:
        """State of the pruning, as JSON values."""
        return {
            "cleared": self.around.count,
            "crowded": self.around.crowded,
            "guide_cleared": self.guided.count,
            "guide_crowded": self.guided.crowded,
        }

    def restore(self, state: dict[str, int | bool]) -> None:
        """Restore the values of `state`; other keys are ignored.

        Raises:
            ValueError, KeyError: they are invalid.
        """
        self.around.restore(state, "cleared", "crowded")
        self.guided.restore(state, "guide_cleared", "guide_crowded")

    def _weights(self, model: Model) -> Iterator[Weights]:
        return weights_by_view(
            self._rasterizer,
            model.params,
            self._shown(),
            antialias=self._config.antialias,
            masks_hide=self._masks_hide,
            scratch=model.grads,  # free after the step
            threads=self._config.threads,
        )

    def _remove(self, model: Model, rows: torch.Tensor) -> None:
        """Remove the splats `rows`, [N] bool, after freeing the rasterizer's memory."""
        self._rasterizer.release()
        row_ops.edit(model, keep=(~rows).nonzero().flatten())
