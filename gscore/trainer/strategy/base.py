"""Strategy interface: the policy that adds, moves and removes splats between steps."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import torch

from ..model.model import Model


@dataclass(frozen=True, kw_only=True)
class Change:
    """Changes of the model by a strategy after a step."""

    added: int = 0
    removed: int = 0
    moved: int = 0
    reset: bool = False
    """True if opacities were reset."""

    def __bool__(self) -> bool:
        return bool(self.added or self.removed or self.moved or self.reset)


@dataclass(frozen=True, kw_only=True)
class DrawnView:
    """The rendered view of a step, as input of a strategy."""

    step: int
    """Number of the step, from 1."""
    radii: torch.Tensor
    """[N] int32 px, 0 for splats that were not drawn."""
    v_means2d: torch.Tensor
    """[N, 2] float32, gradient of the loss in projected means, per px."""
    width: int
    """px."""
    height: int
    """px."""


Within = Callable[[torch.Tensor], torch.Tensor]
"""Test of `means`, [N, 3] in the training frame, against an allowed volume: returns [N] bool."""


def all_within(means: torch.Tensor) -> torch.Tensor:
    """Return [N] bool, all true: no limit."""
    return torch.ones(len(means), dtype=torch.bool, device="cpu")


class Policy(Protocol):
    """A policy without state of its own: its counters are in `Model.rows`.

    A step calls, in this order: `observe`, `shape_gradients`, the optimizer, `after_step`.
    """

    def start(self, model: Model) -> None:
        """Create the counters of the strategy."""
        ...

    def shape_gradients(self, model: Model) -> None:
        """Add the gradients of the strategy's own loss terms."""
        ...

    def observe(self, rows: Mapping[str, torch.Tensor], view: DrawnView) -> None:
        """Add the statistics of a view to `rows`, the counters of `start`."""
        ...

    def after_step(
        self, model: Model, *, step: int, means_lr: float, cap: int, generator: torch.Generator
    ) -> Change:
        """Densify and prune after the optimizer's step `step` with learning rate `means_lr` of the
        means; the model grows to at most `cap` splats."""
        ...
