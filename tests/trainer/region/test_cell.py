"""The cell of a block: what lies in it, in the world and in the training world."""

import numpy as np
import torch

from gscore.blocks.cells import Cells
from gscore.io.block_record import BlockRecord
from gscore.trainer.region.cell import BlockCell
from gscore.transforms import Similarity

AXES = np.array([[0.6, 0.0, 0.8], [-0.8, 0.0, 0.6]])
BOUNDS = np.array([[[-np.inf, -np.inf], [0.5, np.inf]], [[0.5, -np.inf], [np.inf, 0.25]]])
RECORD = BlockRecord(split="s", index=1, axes=AXES, bounds=BOUNDS)


def test_a_cell_holds_what_a_merge_keeps() -> None:
    """Oracle: the cells of `gscore split`, by which blocks are put together."""
    means = np.random.default_rng(0).normal(size=(500, 3)).astype(np.float32)
    means[0] = 0.5 * AXES[0]  # on the end where it begins
    kept = Cells(axes=AXES, bounds=BOUNDS[1:]).holding(means.astype(np.float64))[0]
    found = BlockCell.of(RECORD).holds(torch.from_numpy(means))
    np.testing.assert_array_equal(found.numpy(), kept)
    assert 0.1 < kept.mean() < 0.9


def test_a_cell_moves_with_the_training_world() -> None:
    """Oracle: the same splats, moved and scaled as they are."""
    similarity = Similarity(scale=0.125, shift=np.array([30.0, -4.0, 7.0]))
    means = np.random.default_rng(1).normal(size=(500, 3))
    found = BlockCell.of(RECORD).in_training(similarity)
    moved = torch.from_numpy(similarity.points_to_training(means))
    np.testing.assert_array_equal(
        found.holds(moved).numpy(), BlockCell.of(RECORD).holds(torch.from_numpy(means)).numpy()
    )
