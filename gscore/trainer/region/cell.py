"""The cell of a block: of what is trained on the block, what stays when all are put together."""

from dataclasses import dataclass, replace

import numpy as np
import torch

from ...io.block_record import BlockRecord
from ...transforms import Similarity


@dataclass(frozen=True, kw_only=True)
class BlockCell:
    """An upright prism of some world."""

    axes: np.ndarray
    """[2, 3] float64, directions of length 1 at right angles."""
    low: np.ndarray
    """[2] float64, where it begins along them; what lies there is inside. May be -infinity."""
    high: np.ndarray
    """[2] float64, where it ends."""

    @classmethod
    def of(cls, record: BlockRecord) -> "BlockCell":
        """That of a block, in the world of the capture."""
        low, high = record.bounds[record.index]
        return cls(axes=record.axes, low=low, high=high)

    def in_training(self, similarity: Similarity) -> "BlockCell":
        """The same in the training world."""
        origin = self.axes @ similarity.shift
        low, high = ((end - origin) * similarity.scale for end in (self.low, self.high))
        return replace(self, low=low, high=high)

    def holds(self, means: torch.Tensor) -> torch.Tensor:
        """[N] bool: which of `means` [N, 3] lie in it."""
        ground = means.numpy().astype(np.float64) @ self.axes.T
        return torch.from_numpy(((ground >= self.low) & (ground < self.high)).all(axis=1))
