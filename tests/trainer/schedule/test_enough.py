"""How many steps so many photos are good for; oracle: products by hand."""

from dataclasses import replace
from pathlib import Path

import pytest

from gscore.config import PRESETS, TrainConfig
from gscore.trainer.schedule.enough import enough_steps

TRAIN = TrainConfig(iterations=7000, steps_a_photo=80)


@pytest.mark.parametrize(
    ("photos", "steps"), [(6, 1500), (18, 1500), (25, 2000), (52, 4160), (87, 6960), (88, 7000)]
)
def test_each_photo_is_good_for_so_many(photos: int, steps: int) -> None:
    """Oracle: 80 times the photos, at least 1,500, at most what is asked for."""
    found, why = enough_steps(TRAIN, photos=photos)
    assert found == replace(TRAIN, iterations=steps)
    assert bool(why) == (steps < 7000)
    assert enough_steps(found, photos=photos) == (found, "")


def test_the_sentence() -> None:
    """Oracle: by hand."""
    assert enough_steps(TRAIN, photos=52)[1] == (
        "4,160 of 7,000 steps are taken: more do not make unseen views of 52 photos better "
        "(--steps-a-photo 0 takes them all)."
    )


@pytest.mark.parametrize(
    ("config", "mask_mode"),
    [
        (replace(TRAIN, steps_a_photo=0), "none"),
        (replace(TRAIN, time_budget=60.0), "none"),
        (TRAIN, "composite"),
        (replace(TRAIN, iterations=1500), "ignore"),
    ],
)
def test_where_all_are_taken(config: TrainConfig, mask_mode: str) -> None:
    """Oracle: the text of the option."""
    assert enough_steps(config, photos=10, mask_mode=mask_mode) == (config, "")


def test_which_presets_have_the_limit() -> None:
    """Oracle: preview and draft are what they were; the longer ones have it."""
    limits = {name: make(Path())[1].steps_a_photo for name, make in PRESETS.items()}
    assert limits == {"preview": 0, "draft": 0, "normal": 80, "high": 80}
