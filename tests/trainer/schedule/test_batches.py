"""Photos per step; oracle: counting."""

import pytest

from gscore.trainer.distributed_trainer import batch_size


@pytest.mark.parametrize("size", [1, 2, 3, 8, 64])
def test_steps_end_at_every_due_event(size: int) -> None:
    """Oracle: a step that ends at every multiple, mark and end; no photo is skipped, and no step
    takes more photos than there are processes."""
    taken, ends = 0, []
    while taken < 101:
        count = batch_size(size, taken, every=(10, 25, 0, -1), marks=(33, 200), end=101)
        assert 1 <= count <= size
        taken += count
        ends.append(taken)
    assert taken == 101
    assert {*range(10, 101, 10), 25, 75, 33, 101} <= set(ends)
    if size == 8:
        assert ends[:4] == [8, 10, 18, 20]


def test_a_run_may_go_on_after_its_end() -> None:
    """Oracle: no limit by marks and ends that have passed."""
    assert batch_size(4, 100, every=(), marks=(50,), end=100) == 4
