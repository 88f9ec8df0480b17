"""How much detail photos hold, and how long a run stays at each size."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gscore.config import TrainConfig
from gscore.trainer.photos.spectrum import detail
from gscore.trainer.schedule.plan import Plan
from gscore.trainer.schedule.sizes import SIDES, stages
from gscore.trainer.trainer import Trainer


class Wall:
    """Photos of a wall: `pictures`, [H, W, 3] uint8 each."""

    def __init__(self, *pictures: np.ndarray) -> None:
        self.pictures = pictures

    def image(self, index: int) -> np.ndarray:
        return self.pictures[index]


def looked_at(*pictures: np.ndarray) -> tuple[float, ...]:
    found: Any = Wall(*pictures)
    return detail(found, range(len(pictures)))


def noise(side: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (side, side, 3), dtype=np.uint8)


def waves(side: int, *counts: int) -> np.ndarray:
    """Sines of equal height with `counts` periods across the picture."""
    x = np.arange(side) / side
    row = 128 + 100 * np.mean([np.sin(2 * np.pi * n * x) for n in counts], axis=0)
    return np.repeat(np.repeat(row[None, :, None], side, axis=0), 3, axis=2).astype(np.uint8)


def larger(picture: np.ndarray, side: int) -> np.ndarray:
    """Smoothly, so that no detail comes in."""
    return np.array(Image.fromarray(picture).resize((side, side), Image.Resampling.BICUBIC))


def test_noise_holds_detail_in_proportion_to_the_pixels() -> None:
    """Oracle: white noise has the same amplitude at all frequencies."""
    found = looked_at(noise(256), noise(256, seed=1))
    np.testing.assert_allclose(found, np.square(SIDES), atol=0.02)


def test_a_wave_is_kept_by_sizes_that_can_show_it() -> None:
    """Oracle: 16 and 70 periods in 256 px are 0.125 and 0.55 of Nyquist's frequency, and only sides
    that are a larger share keep them; rounding to bytes leaves a little everywhere."""
    found = looked_at(waves(256, 16, 70))
    expected = [1.0 if side > 0.55 else 0.5 if side > 0.13 else 0.0 for side in SIDES]
    assert set(expected) == {0.0, 0.5, 1.0}
    np.testing.assert_allclose(found, expected, atol=0.06)


def test_soft_photos_hold_less_than_sharp_ones_at_full_size() -> None:
    """Oracle: a photo drawn twice as large as it was has nothing that half of its side loses."""
    sharp = noise(128)
    soft = larger(sharp, 256)
    at_half = SIDES.index(2**-0.75)
    assert looked_at(soft)[at_half] > 0.85 > 0.4 > looked_at(sharp)[at_half]


def test_large_photos_are_looked_at_in_the_middle_and_flat_ones_fall_back() -> None:
    """Oracle: the part itself, and the sides."""
    large = np.zeros((1400, 1200, 3), np.uint8)
    large[188 : 188 + 1024, 88 : 88 + 1024] = noise(1024)
    assert looked_at(large) == looked_at(large[188:1212, 88:1112])
    assert looked_at(np.full((20, 30, 3), 77, np.uint8)) == pytest.approx(SIDES)


def test_stages_follow_the_detail() -> None:
    """Oracle: by hand; detail in proportion to the side reaches the side 2^-1/4 after
    (2^-1/4 - 1/4) / (1 - 1/4) of the time; photos without detail at full size come there last."""
    assert stages(4.0, SIDES) == pytest.approx(
        [(side - 0.25) / 0.75 for side in SIDES[:4]], abs=0.01
    )
    soft = (1.0, 1.0, 1.0, 0.5, 0.4, 0.3, 0.2)
    assert stages(4.0, soft)[:3] == (1.0, 1.0, 1.0)
    sharp = (0.5, 0.25, 0.12, 0.06, 0.03, 0.01, 0.0)
    assert stages(4.0, sharp)[0] < stages(4.0, SIDES)[0]
    for coarse in (1.0, 1.1, 2.0, 5.3, 8.0, 40.0):
        for given in (None, SIDES, soft, sharp, (0.0,) * 7, (1.0,) * 7):
            found = stages(coarse, given)
            assert len(found) == round(2 * np.log2(coarse))
            assert all(0 <= share <= 1 for share in found)
            assert list(found) == sorted(found, reverse=True)


def test_otherwise_pixels_grow_with_the_square_of_the_step() -> None:
    """Oracle: the number of pixels, rounded to a power of 2."""
    config = TrainConfig(iterations=1000, coarse_factor=5.0)
    plan = Plan.of(config, extent=1.0, points=10, side=300, pixels=90_000)
    for step in range(1, 900):
        pixels = 0.04 + 0.96 * (step / 900) ** 2
        assert plan.factor_at(step) == 2.0 ** (round(-np.log2(pixels)) / 2)


def test_a_training_on_soft_photos_stays_small_for_longer(
    make_photos: Callable[..., Any],
) -> None:
    """Oracle: the steps at full size of two trainings that differ in their photos alone."""
    at_full_size = []
    for soft in (False, True):
        photos = make_photos()
        photos.images = [larger(noise(16), 48) if soft else noise(48) for _ in photos.images]
        config = TrainConfig(iterations=100, coarse_factor=3.0, coarse_by_detail=True)
        plan = Trainer(config, photos).plan
        factors = [plan.factor_at(step) for step in range(1, 101)]
        assert factors == sorted(factors, reverse=True)
        assert (factors[0], factors[-1]) == (2.0**1.5, 1.0)
        at_full_size.append(factors.count(1.0))
    assert at_full_size[1] < at_full_size[0]


def test_photos_do_not_matter_unless_they_are_asked(make_photos: Callable[..., Any]) -> None:
    """Oracle: the plan of any photos of that size."""
    photos = make_photos()
    photos.images = [larger(noise(16), 48) for _ in photos.images]
    config = TrainConfig(iterations=100, coarse_factor=3.0)
    assert Trainer(config, photos).plan.stages == stages(3.0)
