"""The cell of a block, in the world and in the training world."""

from typing import Any

import numpy as np

from gscore.blocks.block_cells import Cells
from gscore.config import TrainConfig
from gscore.io.block_record import BlockRecord
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.model.training_frame import TrainingFrame
from gscore.trainer.trainer import Trainer
from gscore.transforms import Similarity

AXES = np.array([[0.6, 0.0, 0.8], [-0.8, 0.0, 0.6]])
BOUNDS = np.array([[[-np.inf, -np.inf], [0.5, np.inf]], [[0.5, -np.inf], [np.inf, 0.25]]])
RECORD = BlockRecord(split="s", index=1, axes=AXES, bounds=BOUNDS)


def test_a_cell_holds_what_lies_between_its_ends() -> None:
    """Oracle: the ends, written out; the same content as the cells of `gscore split`."""
    means = np.random.default_rng(0).normal(size=(500, 3)).astype(np.float32).astype(np.float64)
    means[0] = 0.5 * AXES[0]  # on the end at which it begins
    x, y = means @ AXES[0], means @ AXES[1]
    wanted = (x >= 0.5) & (y < 0.25)
    np.testing.assert_array_equal(RECORD.contains(means), wanted)
    kept = Cells(axes=AXES, bounds=BOUNDS[1:]).contains(means)[0]
    np.testing.assert_array_equal(kept, wanted)
    assert 0.1 < kept.mean() < 0.9


def test_a_cell_moves_with_the_training_world(photos: Any) -> None:
    """Oracle: the same splats, moved and scaled as they are."""
    similarity = Similarity(scale=0.125, shift=np.array([30.0, -4.0, 7.0]))
    frame = TrainingFrame(similarity=similarity, extent=1.0, near=0.01)
    trainer = Trainer(TrainConfig(iterations=1), Analysis(photos=photos, frame=frame, block=RECORD))
    means = np.random.default_rng(1).normal(size=(500, 3))
    moved = similarity.points_to_training(means)
    np.testing.assert_array_equal(trainer._may_grow(moved), RECORD.contains(means))
