"""Strategy interface: the policy that adds, moves and removes splats between steps."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch

from ...engine.base import RowEdit
from ...io.block_record import BlockRecord
from ..model.training_frame import TrainingFrame

Read = Callable[[str], np.ndarray]
"""Returns a column of the model by name, `EngineModel.column`."""


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

    def __add__(self, other: "Change") -> "Change":
        return Change(
            added=self.added + other.added,
            removed=self.removed + other.removed,
            moved=self.moved + other.moved,
            reset=self.reset or other.reset,
        )

    @classmethod
    def of(cls, edit: RowEdit, count: int) -> "Change":
        """The change that an edit makes to a model of `count` splats."""
        return cls(
            added=0 if edit.parents is None else len(edit.parents),
            removed=0 if edit.keep is None else count - len(edit.keep),
            moved=0 if edit.moved is None else len(edit.moved),
            reset=edit.rows is None and "opacities" in edit.values,
        )


Within = Callable[[np.ndarray], np.ndarray]
"""Test of `means`, [N, 3] in the training frame, against an allowed volume: returns [N] bool."""


def all_within(means: np.ndarray) -> np.ndarray:
    """Return [N] bool, all true: no limit."""
    return np.ones(len(means), bool)


def in_cell(block: BlockRecord | None, frame: TrainingFrame) -> Within:
    """Return the test whether splats may be added next to means: in the cell of a block; None:
    everywhere."""
    if block is None:
        return all_within
    world = frame.similarity.points_from_training
    return lambda means: block.contains(world(means), frame.origin)


class Policy(Protocol):
    """A policy without state of its own, which reads columns and never writes."""

    counters: tuple[str, ...]
    """Names of the model's counters that it reads."""
    opacity_reg: float
    """Weight of the mean opacity in the loss (Kheradmand et al. 2024, section 5)."""
    scale_reg: float
    """Weight of the mean scale in the loss."""

    def observes_at(self, step: int) -> bool:
        """Return whether screen-space gradients are counted in `step`."""
        ...

    def noise_at(self, means_lr: float) -> float:
        """Weight of the noise on faint splats after a step with this learning rate of means; 0:
        none."""
        ...

    def refine(
        self, read: Read, *, step: int, cap: int, generator: torch.Generator
    ) -> Iterator[RowEdit]:
        """Yield the edits after the optimizer's `step`, each to be applied before the next; the
        model grows to at most `cap` splats."""
        ...
