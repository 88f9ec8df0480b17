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
"""Share of the splats in a space from which on it is not free."""


class Space(Protocol):
    """Where nothing is to stand."""

    def holds(self, means: torch.Tensor) -> torch.Tensor:
        """[N] bool: which of `means` [N, 3], training world, lie in it."""
        ...


class Emptied:
    """A space that is kept empty, unless so much stands in it that something must be there."""

    def __init__(self, space: Space | None) -> None:
        self._space = space
        self.count = 0
        """Splats taken out of it so far."""
        self.crowded = False
        """Too many stood there at once: it is left as it is."""

    def due(self, means: torch.Tensor) -> torch.Tensor | None:
        """[N] bool: which splats to take out; None: none."""
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
        """Go on from what stands in `state` under these keys, if it does."""
        self.count = as_int(cleared, state.get(cleared, 0))
        self.crowded = state.get(crowded, False) is True


class Pruner:
    """Takes splats out that stand where nothing is, that masks hide, and that add least.

    Each method takes out what is due after a step and returns how many that were.
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
        """`shown` gives the training views at the size of the last step; `masks_hide` says whether
        pixels count only as far as masks show them; `guided` is the space that a guide keeps free.
        What `painter` drew last is lost."""
        self._config = config
        self._rasterizer = rasterizer
        self._shown = shown
        self._masks_hide = masks_hide
        self.around = Emptied(free_space)
        """The space around cameras."""
        self.guided = Emptied(guided)
        """The space before a guide."""

    def prune_free_space(self, model: Model, plan: Plan, step: int) -> int:
        """Take out what stands where nothing is to stand: around cameras and before a guide."""
        if not plan.prunes_free_space_at(step):
            return 0
        before = len(model)
        for space in (self.around, self.guided):
            rows = space.due(model.params["means"])
            if rows is not None:
                self._take_out(model, rows)
        return before - len(model)

    def prune_masked(self, model: Model, plan: Plan, step: int) -> int:
        """Take out what stands where masks hide it."""
        share = self._config.hidden_share
        if share == 0 or not self._masks_hide or not plan.prunes_masked_at(step):
            return 0
        hidden = mostly_masked(self._weights(model), len(model), share=share)
        count = int(hidden.sum())
        if count == 0 or count == len(model):
            return 0
        self._take_out(model, hidden)
        return count

    def prune_least(self, model: Model, plan: Plan, step: int, *, pruned: int) -> int:
        """Take out what adds least to the photos, once there are to be fewer splats; `pruned` went
        as such before."""
        count = plan.surplus_at(step, len(model), pruned)
        if count == 0:
            return 0
        self._take_out(
            model, lowest_rows(max_contribution(self._weights(model), len(model)), count)
        )
        return count

    def state(self) -> dict[str, int | bool]:
        """All that the next removals depend on, as JSON values."""
        return {
            "cleared": self.around.count,
            "crowded": self.around.crowded,
            "guide_cleared": self.guided.count,
            "guide_crowded": self.guided.crowded,
        }

    def restore(self, state: dict[str, int | bool]) -> None:
        """Go on from what `state` returned, among other keys.

        Raises:
            ValueError, KeyError: it is not what that returns.
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
            scratch=model.grads,  # they were for the step that is done
            threads=self._config.threads,
        )

    def _take_out(self, model: Model, rows: torch.Tensor) -> None:
        """Edit the model so that it goes on without these splats, [N] bool; the rasterizer's memory
        makes room for that."""
        self._rasterizer.release()
        row_ops.edit(model, keep=(~rows).nonzero().flatten())
