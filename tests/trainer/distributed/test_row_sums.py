"""Rows and gradients summed over ranks; oracle: plain loops in one process."""

from pathlib import Path

import pytest

from .start_ranks import start

HERE = "tests.trainer.distributed"


@pytest.mark.parametrize("ranks", [2, 3])
def test_rows_add_up_in_the_order_of_the_ranks(ranks: int) -> None:
    """Oracle: float32 sums in a loop over the ranks, to the bit."""
    assert Path(__file__).with_name("sums_of_ranks.py").is_file()
    for ended in start(*[["-m", f"{HERE}.sums_of_ranks"]] * ranks):
        assert ended.code == 0, ended.err


def test_a_step_of_two_ranks_learns_from_both_photos() -> None:
    """Oracle: the same kernels on each photo in one process; means and sums, to the bit."""
    for ended in start(*[["-m", f"{HERE}.step_of_ranks"]] * 2):
        assert ended.code == 0, ended.err


@pytest.mark.parametrize("collected", ["before", "then"])
def test_a_photo_that_is_gone_loses_nothing_that_has_gathered(collected: str) -> None:
    """Oracle: the accumulated gradients of each rank; both ends within the timeout."""
    for ended in start(*[["-m", f"{HERE}.failing_ranks", collected]] * 2):
        assert ended.code == 0, ended.err
