"""Dropout; opacity by masks or everywhere; oracles: expectations, formulas, counts."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from gscore.config import Background, TrainConfig
from gscore.engine.cpu.loss import mean_transmittance, opacity_loss
from gscore.engine.cpu.splat_terms import drop_splats
from gscore.presets import PRESETS
from gscore.raster.random_numbers import uniform_rows
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.schedule.caps import drop_rate_at, drop_rate_of
from gscore.trainer.trainer import Trainer


@pytest.mark.parametrize(
    ("below", "known", "mask_mode", "rate"),
    [
        (0.0, None, "none", 0.1),
        (0.0, 0.9, "composite", 0.1),
        (0.35, None, "none", 0.0),
        (0.35, 0.0, "none", 0.1),
        (0.35, 0.349, "ignore", 0.1),
        (0.35, 0.35, "none", 0.0),
        (0.35, 0.1, "composite", 0.0),
        (0.35, 0.49, "composite", 0.0),
        (0.35, 0.5, "composite", 0.1),
        (0.35, None, "composite", 0.0),
    ],
)
def test_where_splats_are_left_out(
    below: float, known: float | None, mask_mode: str, rate: float
) -> None:
    """Oracle: the text of the option; the sentence that comes with the condition."""
    config = TrainConfig(drop_rate=0.1, drop_below=below)
    found, decision = drop_rate_of(config, known=known, mask_mode=mask_mode)
    assert found == rate
    assert (decision is not None) == bool(below and rate)
    if decision is not None:
        whose, text = "the subject's" if mask_mode == "composite" else "their", decision.text
        assert f"{known:.0%} of {whose} pixels" in text and "10% of the splats" in text
        assert decision.topic == "drops"
    assert drop_rate_of(replace(config, drop_rate=0.0), known=known, mask_mode=mask_mode)[0] == 0


def test_which_presets_leave_splats_out() -> None:
    """Oracle: the presets with stereo, without which the condition is never met."""
    for name, make in PRESETS.items():
        config = make(Path())[1]
        longer = name in ("normal", "high", "highest")
        assert (config.drop_rate, config.drop_below) == ((0.1, 0.35) if longer else (0, 0))


def test_the_share_left_out_rises_evenly() -> None:
    """Oracle: equation 5 of Park et al. 2025: rate * step / steps."""
    assert [drop_rate_at(0.2, step, 1000) for step in (0, 500, 1000, 2000)] == pytest.approx(
        [0, 0.1, 0.2, 0.2]
    )


def test_the_expected_opacity_stays() -> None:
    """Oracle: the opacity itself as the mean over many draws; a share of `rate` is dropped."""
    logits = torch.full((200_000,), -0.5)
    out = torch.sigmoid(
        drop_splats(logits, 0.25, uniform_rows(len(logits), seed=1, step=1, stream=0))
    )
    gone = out < 1e-9
    assert float(gone.float().mean()) == pytest.approx(0.25, abs=0.005)
    assert float(out.mean()) == pytest.approx(float(torch.sigmoid(logits[0])), rel=0.01)


def test_gradients_are_those_of_the_scaled_opacity() -> None:
    """Oracle: d o/(1-r) / d logit = o (1 - o) / (1 - r), at the ceiling too; none when dropped."""
    logits = torch.tensor([-2.0, 0.3, 4.0, 9.0], dtype=torch.float64).repeat(50).requires_grad_()
    out = drop_splats(logits, 0.2, uniform_rows(len(logits), seed=0, step=1, stream=0))
    opacity = torch.sigmoid(out)
    opacity.sum().backward()
    o = torch.sigmoid(logits.detach())
    expected = torch.where(out > -20, o * (1 - o) / 0.8, 0.0)
    assert logits.grad is not None
    torch.testing.assert_close(logits.grad, expected, rtol=1e-6, atol=1e-12)
    assert float(opacity.detach().max()) == pytest.approx(0.999)


def test_opacity_loss_is_its_formula() -> None:
    """Oracle: numpy."""
    rng = np.random.default_rng(0)
    alpha, mask = rng.uniform(size=(6, 7)), rng.integers(0, 256, (6, 7)).astype(np.uint8)
    found = opacity_loss(torch.from_numpy(alpha), torch.from_numpy(mask))
    assert float(found) == pytest.approx(np.abs(alpha - mask / 255).mean(), rel=1e-12)


@pytest.mark.parametrize("masked", [False, True])
def test_transmittance_loss_matches_its_formula(masked: bool) -> None:
    """Oracle: numpy, and autograd of the same formula in float64."""
    rng = np.random.default_rng(0)
    mask = rng.integers(0, 256, (6, 7)).astype(np.uint8) if masked else None
    alpha = torch.from_numpy(rng.uniform(size=(6, 7))).requires_grad_()
    weights = np.ones((6, 7)) if mask is None else mask / 255
    expected = ((1 - alpha) * torch.from_numpy(weights)).mean()
    expected.backward()
    value, slope = mean_transmittance(alpha.detach(), mask)
    assert value == pytest.approx(float(expected), rel=1e-12)
    torch.testing.assert_close(slope, alpha.grad)


def test_black_surfaces_are_no_holes(make_photos: Any) -> None:
    """Oracle: as for opacity masks, but of photos without masks; no effect on pixels that a mask
    ignores."""
    photos = make_photos()
    for i in range(len(photos.images)):
        photos.images[i] = np.zeros((48, 48, 3), np.uint8)
    config = TrainConfig(iterations=40, max_splats=200, coarse_factor=1, sh_degree=0)

    def opacity(weight: float) -> float:
        trainer = Trainer(replace(config, opaque_weight=weight), Analysis(photos=photos))
        for _ in range(40):
            trainer.step()
        return float(torch.sigmoid(trainer.model.params["opacities"]).detach().mean())

    without, asked = opacity(0.0), opacity(1.0)
    assert asked > 2 * without, (asked, without)
    for i in range(len(photos.images)):
        photos.masks[i] = np.zeros((48, 48), np.uint8)
    photos.mask_mode = "ignore"
    assert opacity(1.0) == opacity(0.0)


def test_splats_left_out_are_not_drawn_and_do_not_change(photos: Any) -> None:
    """Oracle: no gradient at all for about half of the splats in the last step of a run."""
    config = TrainConfig(iterations=1, max_splats=400, drop_rate=0.5, coarse_factor=1)
    trainer = Trainer(config, Analysis(photos=photos))
    before = trainer.model.params["opacities"].detach().clone()
    trainer.step()
    same = float((trainer.model.params["opacities"].detach() == before).float().mean())
    whole = Trainer(replace(config, drop_rate=0.0), Analysis(photos=photos))
    whole.step()
    hidden = float((whole.model.params["opacities"].detach() == before).float().mean())
    assert hidden < 0.2
    assert 0.3 < same < 0.8  # 25 blocks of rows


def test_masks_ask_for_opacity(make_photos: Any) -> None:
    """Oracle: black photos on black, so that only the masks can raise opacity."""
    photos = make_photos()
    for i in range(len(photos.images)):
        photos.images[i] = np.zeros((48, 48, 3), np.uint8)
        photos.masks[i] = np.full((48, 48), 255, np.uint8)
    photos.mask_mode = "composite"
    config = TrainConfig(
        iterations=40, max_splats=200, coarse_factor=1, sh_degree=0, background=Background.BLACK
    )
    means = []
    for weight in (0.0, 1.0):
        trainer = Trainer(replace(config, alpha_weight=weight), Analysis(photos=photos))
        for _ in range(40):
            trainer.step()
        means.append(float(torch.sigmoid(trainer.model.params["opacities"]).detach().mean()))
    assert means[1] > 2 * means[0], means
