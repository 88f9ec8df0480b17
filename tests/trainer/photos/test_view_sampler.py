"""Samples of the training views. Oracle: counting."""

import pytest

from gscore.trainer.photos.view_sampler import mixed


@pytest.mark.parametrize("period", [1, 2, 3, 5, 7])
def test_a_sample_has_all_exposures_of_brackets(period: int) -> None:
    """Every one of `period` exposures in turn is in a sample of eight, whose views are different
    and from all parts of the capture; also if the last bracket is incomplete."""
    for count in range(1, 400):
        chosen = mixed(range(100, 100 + count), 8)
        assert len(set(chosen)) == min(count, 8) and chosen == sorted(chosen)
        if (count >= 8 and count % period == 0) or count >= 10 * period:
            assert {view % period for view in chosen} == set(range(period)), count
        if count >= 32:
            parts = {(view - 100) * 4 // count for view in chosen}
            assert len(parts) >= 3, count


def test_none() -> None:
    """No views are no error."""
    assert mixed([], 8) == []
