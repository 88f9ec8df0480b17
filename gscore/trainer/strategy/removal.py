"""Splats that go because of what photos, masks and cameras say, whatever the strategy does."""

from collections.abc import Callable, Iterable, Iterator

import torch

from ...config import TrainConfig
from ...raster.painter import Painter
from ..photos.pyramid import Sized
from ..rows.model import Model
from ..rows.stored import whole
from ..schedule.plan import Plan
from . import ops
from .contribution import Weights, least, most_in_a_view, mostly_hidden, weights_by_view
from .free_space import FreeSpace

_CROWD = 0.2
"""Share of the splats in the free space around cameras from which on it is not free."""


class Removal:
    """Takes splats out that stand where nothing is, that masks hide, and that add least.

    Each method takes out what is due after a step and returns how many that were.
    """

    def __init__(
        self,
        config: TrainConfig,
        free_space: FreeSpace,
        painter: Painter,
        shown: Callable[[], Iterable[Sized]],
        *,
        masks_hide: bool,
    ) -> None:
        """`shown` gives the training views at the size of the last step; `masks_hide` says whether
        pixels count only as far as masks show them. What `painter` drew last is lost."""
        self._config = config
        self._free_space = free_space
        self._painter = painter
        self._shown = shown
        self._masks_hide = masks_hide
        self.cleared = 0
        """Splats taken out so far because they stood too close before a camera."""
        self.crowded = False
        """So many stood there at once that something must be there: no space is free."""
        self._pruned = 0

    def clear(self, model: Model, plan: Plan, step: int) -> int:
        """Take out what stands in the free space around cameras."""
        if self.crowded or not plan.clears_at(step):
            return 0
        inside = self._free_space.holds(model.params["means"])
        count = int(inside.sum())
        self.crowded = count > _CROWD * len(model)
        if count == 0 or self.crowded:
            return 0
        self._take_out(model, inside)
        self.cleared += count
        return count

    def unveil(self, model: Model, plan: Plan, step: int) -> int:
        """Take out what stands where masks hide it."""
        share = self._config.hidden_share
        if share == 0 or not self._masks_hide or not plan.unveils_at(step):
            return 0
        hidden = mostly_hidden(self._weights(model), len(model), share=share)
        count = int(hidden.sum())
        if count == 0 or count == len(model):
            return 0
        self._take_out(model, hidden)
        return count

    def prune(self, model: Model, plan: Plan, step: int) -> int:
        """Take out what adds least to the photos, once there are to be fewer splats."""
        count = plan.surplus_at(step, len(model), self._pruned)
        if count == 0:
            return 0
        self._take_out(model, least(most_in_a_view(self._weights(model), len(model)), count))
        self._pruned += count
        return count

    def state(self) -> dict[str, int | bool]:
        """All that the next removals depend on, as JSON values."""
        return {"cleared": self.cleared, "crowded": self.crowded, "pruned": self._pruned}

    def restore(self, state: dict[str, int | bool]) -> None:
        """Go on from what `state` returned, among other keys.

        Raises:
            ValueError, KeyError: it is not what that returns.
        """
        self.cleared = whole("cleared", state.get("cleared", 0))
        self.crowded = state.get("crowded", False) is True
        self._pruned = whole("pruned", state["pruned"])

    def _weights(self, model: Model) -> Iterator[Weights]:
        return weights_by_view(
            self._painter,
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
        self._painter.release()
        ops.edit(model, keep=(~rows).nonzero().flatten())
