"""Caps of steps and splats by the number of photos; oracle: products by hand."""

from dataclasses import replace
from pathlib import Path

import pytest

from gscore.config import Stereo, TrainConfig
from gscore.events import Decision
from gscore.presets import PRESETS
from gscore.trainer.schedule.caps import cap_by_photos, drops_splats_of_subject, expected_points

TRAIN = TrainConfig(iterations=7000, steps_a_photo=80)


@pytest.mark.parametrize(
    ("photos", "steps"), [(6, 1500), (18, 1500), (25, 2000), (52, 4160), (87, 6960), (88, 7000)]
)
def test_each_photo_is_good_for_so_many(photos: int, steps: int) -> None:
    """Oracle: 80 times the photos, at least 1,500, at most the option."""
    found, why = cap_by_photos(TRAIN, photos=photos)
    assert found == replace(TRAIN, iterations=steps)
    assert bool(why) == (steps < 7000)
    assert cap_by_photos(found, photos=photos) == (found, None)


def test_the_sentence() -> None:
    """Oracle: by hand."""
    assert cap_by_photos(TRAIN, photos=52)[1] == Decision(
        "enough",
        "4,160 of 7,000 steps are taken: more do not improve unseen views with 52 photos "
        "(`--steps-a-photo 0` takes them all).",
    )


def test_a_subject_that_is_cut_out_is_good_for_twice_as_many() -> None:
    """Oracle: 160 times the photos, and the requested number of splats."""
    long = replace(TRAIN, iterations=15_000, splats_a_photo=6000, max_splats=600_000)
    for photos, steps in ((5, 1500), (50, 8000), (100, 15_000)):
        found, why = cap_by_photos(long, photos=photos, mask_mode="composite")
        assert found == replace(long, iterations=steps)
        assert (why is not None and "steps are taken" in why.text) == (steps < 15_000)


def test_how_many_points_are_expected() -> None:
    """Oracle: the points of the capture; else the number to search, or 100,000 random ones."""
    config = TrainConfig(max_splats=20_000)
    assert expected_points(config, 3000) == 3000
    assert expected_points(config, 0) == 4000
    assert expected_points(replace(config, stereo=Stereo.OFF), 0) == 100_000


@pytest.mark.parametrize(
    ("known", "rate", "steps"),
    [
        (0.5, 0.1, 4000),
        (0.49, 0.1, 8000),
        (None, 0.1, 8000),
        (0.9, 0.0, 8000),
    ],
)
def test_a_subject_of_which_splats_are_left_out(
    known: float | None, rate: float, steps: int
) -> None:
    """Oracle: the texts of the options; 80 or 160 times 50 photos."""
    config = replace(TRAIN, iterations=15_000, drop_rate=rate)
    found, _ = cap_by_photos(config, photos=50, mask_mode="composite", known=known)
    assert found.iterations == steps
    assert not drops_splats_of_subject(config, mask_mode="ignore", known=known)


@pytest.mark.parametrize(
    ("config", "mask_mode"),
    [
        (replace(TRAIN, steps_a_photo=0), "none"),
        (replace(TRAIN, time_budget=60.0), "none"),
        (replace(TRAIN, iterations=1500), "ignore"),
    ],
)
def test_where_all_are_taken(config: TrainConfig, mask_mode: str) -> None:
    """Oracle: the text of the option."""
    assert cap_by_photos(config, photos=10, mask_mode=mask_mode) == (config, None)


def test_which_presets_have_the_limit() -> None:
    """Oracle: all but previews, from `high` on for splats too."""
    limits = {name: make(Path())[1].steps_a_photo for name, make in PRESETS.items()}
    assert limits == {"preview": 0, "draft": 68, "normal": 80, "high": 80, "highest": 80}
    limits = {name: make(Path())[1].splats_a_photo for name, make in PRESETS.items()}
    assert limits == {"preview": 0, "draft": 0, "normal": 0, "high": 6000, "highest": 20_000}


def test_each_model_may_have_as_many_splats_as_one_alone() -> None:
    """Oracle: twice 60 times 6,000, by hand."""
    config = TrainConfig(max_splats=900_000, splats_a_photo=6000, ensemble=2)
    found, why = cap_by_photos(config, photos=60)
    assert found == replace(config, max_splats=720_000)
    assert why is not None and "grows to 720,000 of 900,000 splats" in why.text
    high = PRESETS["high"](Path())[1]
    assert cap_by_photos(high, photos=30)[0].max_splats == high.max_splats
    agreeing, _ = cap_by_photos(high, photos=30, known=0.5, compared=True)
    assert agreeing.max_splats == 300_000


@pytest.mark.parametrize(
    ("photos", "splats"),
    [(6, 300_000), (50, 300_000), (52, 312_000), (99, 594_000), (100, 600_000)],
)
def test_each_photo_is_good_for_so_many_splats(photos: int, splats: int) -> None:
    """Oracle: 6,000 times the photos, at least 300,000, at most the option."""
    config = TrainConfig(max_splats=600_000, splats_a_photo=6000)
    found, why = cap_by_photos(config, photos=photos)
    assert found == replace(config, max_splats=splats)
    assert cap_by_photos(found, photos=photos) == (found, None)
    assert cap_by_photos(config, photos=photos, mask_mode="composite") == (config, None)
    assert cap_by_photos(replace(config, splats_a_photo=0), photos=photos)[1] is None
    reported = (
        f"The model grows to {splats:,} of 600,000 splats: more do not improve unseen views with "
        f"{photos} photos (`--splats-a-photo 0` allows them all)."
    )
    assert why == (None if photos == 100 else Decision("enough", reported))


def test_both_caps_are_reported() -> None:
    """Oracle: the sentences of each alone."""
    both = replace(TRAIN, max_splats=600_000, splats_a_photo=6000)
    steps, splats = replace(both, splats_a_photo=0), replace(both, steps_a_photo=0)
    alone = [cap_by_photos(one, photos=20)[1] for one in (steps, splats)]
    found = cap_by_photos(both, photos=20)[1]
    assert found == Decision("enough", " ".join(one.text for one in alone if one is not None))
