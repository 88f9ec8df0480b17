"""Growing photo sizes of a run that starts small."""

import numpy as np
import pytest

from gscore.config import TrainConfig
from gscore.trainer.schedule.plan import Plan, photo_size_stages


@pytest.mark.parametrize("coarse", [1.0, 1.1, 2.0, 5.3, 8.0, 40.0])
def test_there_is_a_stage_for_each_size(coarse: float) -> None:
    """Oracle: sizes a root of 2 apart, and increasing shares of a time."""
    found = photo_size_stages(coarse)
    assert len(found) == round(2 * np.log2(coarse))
    assert all(0 <= share <= 1 for share in found)
    assert list(found) == sorted(found, reverse=True)


def test_pixels_grow_with_the_square_of_the_step() -> None:
    """Oracle: the number of pixels, rounded to a power of 2."""
    config = TrainConfig(iterations=1000, coarse_factor=5.0)
    plan = Plan.of(config, extent=1.0, points=10, side=300, pixels=90_000)
    for step in range(1, 900):
        pixels = 0.04 + 0.96 * (step / 900) ** 2
        assert plan.factor_at(step) == 2.0 ** (round(-np.log2(pixels)) / 2)
