"""Oracle: the same training without the skip, bit for bit."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

from gscore.config import Skip, TrainConfig
from gscore.splats import PARAMETERS
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.photos.image_pyramid import tiles_of_mask
from gscore.trainer.trainer import Trainer

_INEXACT = (Skip.SMALL_PHOTOS, Skip.UNSEEN_SH, Skip.RARE_SH)
_EXACT = [skip for skip in Skip if skip not in _INEXACT]


_WORK = {
    Skip.EXACT_CULL: "forward_pairs",
    Skip.OPACITY_EXTENT: "forward_pairs",
    Skip.ROW_RANGE: "forward_pairs",
    Skip.ZERO_TILE: "backward_pairs",
    Skip.MASKED_TILE: "forward_pairs",
}
"""Work that skips of the rasterizer save."""


def _trained(photos: Any, *without: Skip, work: str = "forward_pairs") -> tuple[Trainer, float]:
    """A short training, and the amount of `work` that it did."""
    config = TrainConfig(
        iterations=40, sh_degree=2, sh_every=15, refine_start=10, refine_every=10, without=without
    )
    trainer, done = Trainer(config, Analysis(photos=photos)), 0.0
    for _ in range(40):
        trainer.step()
        done += trainer.stage_timer.raster[work]
    return trainer, done


@pytest.fixture
def masked(make_photos: Callable[..., Any]) -> Any:
    """The toy capture with `ignore` masks that hide a column of tiles."""
    photos = make_photos()
    photos.mask_mode = "ignore"
    for index, image in enumerate(photos.images):
        mask = np.full(image.shape[:2], 255, np.uint8)
        mask[:, 20:] = 0
        photos.masks[index] = mask
    return photos


@pytest.mark.parametrize("skip", _EXACT)
def test_exact_skips_leave_every_bit(masked: Any, isa: str, skip: Skip) -> None:
    """Oracle: as above; less work for the rasterizer."""
    torch.set_num_threads(1)
    # Only the tiles that a mask hides have no gradient here, so the first pass must draw them.
    others = (Skip.MASKED_TILE,) if skip is Skip.ZERO_TILE else ()
    work = _WORK.get(skip, "forward_pairs")
    fast, little = _trained(masked, *others, work=work)
    full, much = _trained(masked, *others, skip, work=work)
    assert 0 < little < much if skip in _WORK else little == much > 0
    assert len(fast.model) == len(full.model) > 0
    ours, theirs = fast.splats(), full.splats()
    for name in PARAMETERS:
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))


def test_rows_that_wait_come_out_as_if_they_had_not(masked: Any) -> None:
    """Oracle: every row takes every step; equal but for rounding, which a training magnifies."""
    fast, full = _trained(masked)[0], _trained(masked, Skip.UNSEEN_SH)[0]
    assert len(fast.model) == len(full.model) > 0
    np.testing.assert_allclose(fast.splats().shN, full.splats().shN, atol=2e-4)
    np.testing.assert_allclose(fast.splats().means, full.splats().means, atol=2e-4)


def test_rare_steps_of_higher_coefficients_can_be_switched_off(photos: Any) -> None:
    """Oracle: the plan, and the number of steps of the optimizer."""
    for without, steps in (((), 4), ((Skip.RARE_SH,), 29)):  # there are none before step 2
        config = TrainConfig(iterations=30, sh_degree=1, sh_every=1, shN_every=9, without=without)
        trainer = Trainer(config, Analysis(photos=photos))
        for _ in range(30):
            trainer.step()
        assert trainer.model.adam_steps["means"] == 30
        assert trainer.model.adam_steps["shN"] == steps


def test_small_photos_can_be_switched_off(make_photos: Callable[..., Any]) -> None:
    """Oracle: the size of the first step's photo."""
    photos = make_photos()
    config = TrainConfig(iterations=40, coarse_factor=2.0)
    assert Trainer(config, Analysis(photos=photos)).plan.factor_at(1) == 2.0
    config = TrainConfig(iterations=40, coarse_factor=2.0, without=(Skip.SMALL_PHOTOS,))
    assert Trainer(config, Analysis(photos=photos)).plan.factor_at(1) == 1.0


def test_tiles_of_a_mask() -> None:
    """Oracle: by hand; a tile is kept for one pixel, and the rim is a tile of its own."""
    mask = np.zeros((33, 20), np.uint8)
    mask[15, 16] = 1
    mask[32, 0] = 255
    np.testing.assert_array_equal(tiles_of_mask(mask), [[0, 1], [0, 0], [1, 0]])
