"""Rows and gradients of several ranks; oracle: plain loops in one process."""

from pathlib import Path

from .started import start

HERE = "tests.trainer.ranks"


def test_rows_add_up_in_the_order_of_the_ranks() -> None:
    """Oracle: float32 sums in a loop over three ranks, to the bit."""
    assert Path(__file__).with_name("sums_together.py").is_file()
    for ended in start(*[["-m", f"{HERE}.sums_together"]] * 3):
        assert ended.code == 0, ended.err


def test_a_step_of_two_ranks_learns_from_both_photos() -> None:
    """Oracle: the same kernels on each photo in one process; means and sums, to the bit."""
    for ended in start(*[["-m", f"{HERE}.steps_together"]] * 2):
        assert ended.code == 0, ended.err
