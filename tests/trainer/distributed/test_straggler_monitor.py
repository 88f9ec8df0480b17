"""The rank that the others wait for; oracle: made-up seconds."""

import numpy as np

from gscore.trainer.distributed.straggler_monitor import StragglerMonitor


def messages(seconds: list[float], *, batches: int) -> list[str]:
    """Messages about batches on which the ranks work for these seconds."""
    waits = StragglerMonitor(["a", "b", "c"])
    met = (waits.straggler_message(batch * np.array(seconds)) for batch in range(batches))
    return [sentence for sentence in met if sentence]


def test_a_slow_rank_is_named_once() -> None:
    """Oracle: three times the work of the others, reported once in many steps."""
    (sentence,) = messages([0.3, 0.9, 0.3], batches=100)
    assert sentence.startswith("All wait for rank 1 (b), which works 3.0 times as long")


def test_similar_ranks_are_not_reported() -> None:
    """Oracle: a third more work; too few batches or seconds for a decision."""
    assert not messages([0.8, 0.6, 0.6], batches=100)
    assert not messages([0.3, 0.9, 0.3], batches=12)
    assert not messages([0.003, 0.009, 0.003], batches=100)
