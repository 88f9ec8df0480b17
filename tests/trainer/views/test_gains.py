"""Gains of photos: their steps, their centre, the chain of their derivative, checkpoints."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import gscore
from gscore.config import Background
from gscore.engine.cpu.loss import without_background
from gscore.photo_exposure import PhotoExposure
from gscore.raster.loss import image_loss_gradient
from gscore.raster.reference import image_loss_reference, rasterize_reference, unexposed_reference
from gscore.raster.request import Frustum, Settings
from gscore.raster.training_rasterizer import TrainingRasterizer
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.files import checkpoint
from gscore.trainer.trainer import Trainer
from gscore.trainer.views.photo_adam import rate_at
from gscore.trainer.views.photo_gains import PhotoGains
from tests.light_changes import exposed_bytes
from tests.trainer.short_run import CONFIG

BASIS = np.array([[1.0, 1.0, 1.0], [1.0, 0.0, -1.0], [-0.5, 1.0, -0.5]])
"""Exposure, warmth, green."""


def some_gains(photos: Any, seed: int = 0, *, spread: float = 0.2) -> np.ndarray:
    """[V, 3] ln gains at random."""
    return np.random.default_rng(seed).normal(size=(len(photos.scene.cameras), 3)) * spread


def exposed(photos: Any, log_gains: np.ndarray) -> Any:
    """The photos with these gains."""
    images = [
        exposed_bytes(image, np.exp(gain))
        for image, gain in zip(photos.images, log_gains, strict=True)
    ]
    return replace(photos, images=images)


def test_steps_are_those_of_adam() -> None:
    """Oracle: torch's Adam on the three numbers of one photo; a third of each step is subtracted
    from all three photos, by hand."""
    gains = PhotoGains([0, 2, 3], np.zeros((4, 3)))
    value = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    adam = torch.optim.Adam([value], lr=0.01, eps=1e-15)
    rng = np.random.default_rng(0)
    for _ in range(5):
        v = rng.normal(size=3)
        gains.learn(2, v, 0.01)
        value.grad = torch.from_numpy(BASIS @ v)
        before = value.detach().clone()
        adam.step()
        with torch.no_grad():
            value -= (value - before) / 3
    found = gains.log_gains
    own = value.detach().numpy() @ BASIS
    np.testing.assert_allclose(found[2], own, rtol=1e-12)
    np.testing.assert_allclose(found[[0, 3]], [-own / 2] * 2, rtol=1e-12)
    assert not found[1].any()


def test_the_mean_over_training_photos_stays_one() -> None:
    """Oracle: the geometric mean; a gain of exactly one for held-out photos."""
    gains = PhotoGains([1, 2, 4], np.random.default_rng(1).normal(size=(5, 3)))
    for index in (1, 2, 4, 2):
        gains.learn(index, [1.0, -2.0, 0.5], 0.1)
        assert np.abs(gains.log_gains[[1, 2, 4]].mean(axis=0)).max() < 1e-15
    assert gains.of(0) == (1.0, 1.0, 1.0)


def test_a_derivative_that_is_not_finite_moves_nothing() -> None:
    """Oracle: the previous gains."""
    gains = PhotoGains([0, 1], np.array([[0.1, 0, 0], [-0.1, 0, 0]]))
    before = {key: a.copy() for key, a in gains.arrays().items()}
    gains.learn(0, [float("nan"), 1.0, 1.0], 0.1)
    assert all(np.array_equal(a, before[key]) for key, a in gains.arrays().items())


def test_the_rate_falls_exponentially() -> None:
    """Oracle: powers of ten by hand; 0 stays 0."""
    assert rate_at(1e-2, 1e-4, 0.0) == pytest.approx(1e-2)
    assert rate_at(1e-2, 1e-4, 0.5) == pytest.approx(1e-3)
    assert rate_at(1e-2, 1e-4, 2.0) == pytest.approx(1e-4)
    assert rate_at(0.0, 1e-4, 0.5) == 0.0


@pytest.mark.parametrize("mode", ["none", "ignore", "composite"])
def test_the_chain_from_the_loss_to_a_gain(known_splats: Any, photos: Any, mode: str) -> None:
    """Oracle: the float64 twin of rasterizer and loss; autograd in ln gain, through the background
    colour too where photos are composited over one, and central differences."""
    height = width = 24
    camera = photos.scene.cameras
    K = camera.Ks[0] * [[0.5], [0.5], [1.0]]
    background, gain = (0.2, 0.5, 0.9), (1.25, 0.9, 0.8)
    generator = torch.Generator().manual_seed(0)
    target = torch.randint(0, 256, (height, width, 3), generator=generator, dtype=torch.uint8)
    mask = torch.randint(0, 256, (height, width), generator=generator, dtype=torch.uint8)
    raw = [torch.from_numpy(getattr(known_splats, n)) for n in _NAMES]
    view = Frustum(
        torch.from_numpy(camera.viewmats[0]).float(), torch.from_numpy(K).float(), 24, 24
    )
    options = {"mask": mask, "mask_mode": mode, "background": background}

    rasterizer = TrainingRasterizer()
    behind = PhotoExposure.of(gain).behind(background)
    shown = behind if mode == "composite" else background
    picture = rasterizer.draw(raw, view, Settings(background=shown))
    v_rgb = torch.empty_like(picture.rgb)
    found = image_loss_gradient(picture.rgb, target, v_rgb, gain=torch.tensor(gain), **options)
    photo_parameters = found.v_log_gain
    if mode == "composite":
        photo_parameters = without_background(
            photo_parameters, background, gain, v_rgb, picture.alpha
        )

    def loss_of(log_gain: torch.Tensor) -> torch.Tensor:
        by = log_gain.exp()
        behind_all = torch.tensor(background, dtype=torch.float64)
        if mode == "composite":
            behind_all = unexposed_reference(behind_all, by)
        out = rasterize_reference(
            *_activated(raw),
            torch.from_numpy(camera.viewmats[0]),
            torch.from_numpy(K),
            width,
            height,
        )
        rgb = out.rgb + (1 - out.alpha)[..., None] * behind_all
        return image_loss_reference(rgb, target, gain=by, **options)[0]

    at = torch.tensor(gain).double().log().requires_grad_()
    loss_of(at).backward()
    assert at.grad is not None
    assert torch.tensor(photo_parameters).double() == pytest.approx(at.grad, abs=1e-5)
    step = 1e-5
    for c in range(3):
        aside = torch.zeros(3, dtype=torch.float64)
        aside[c] = step
        with torch.no_grad():
            slope = (loss_of(at + aside) - loss_of(at - aside)).item() / (2 * step)
        assert at.grad[c].item() == pytest.approx(slope, abs=1e-6)


_NAMES = ("means", "quats", "scales", "opacities", "sh0", "shN")


def _activated(raw: list[torch.Tensor]) -> list[torch.Tensor]:
    """float64 parameters as the twin expects them."""
    means, quats, scales, opacities, sh0, shN = (t.double() for t in raw)
    return [means, quats, scales.exp(), torch.sigmoid(opacities), sh0, shN]


def test_gains_of_photos_are_found(make_photos: Callable[..., Any]) -> None:
    """Oracle: the gains applied to the photos, about their mean, more than half of which is
    recovered without an initial estimate."""
    plain = make_photos(held_out=(3,))
    truth = some_gains(plain, spread=0.15)
    truth[3] = 0
    truth -= truth[plain.train].mean(axis=0) * np.isin(np.arange(8), plain.train)[:, None]
    config = replace(
        CONFIG, iterations=400, background=Background.BLACK, exposure_lr=0.03, sh_degree=0
    )
    photos = exposed(plain, truth)
    trainer = Trainer(
        config, Analysis(photos=photos, gains=PhotoGains(photos.train, np.zeros((8, 3))))
    )
    for _ in range(config.iterations):
        trainer.step()
    assert trainer.photo_parameters.gains is not None
    apart = np.abs(trainer.photo_parameters.gains.log_gains - truth)[plain.train]
    assert apart.max() < 0.1
    assert apart.mean() < 0.6 * np.abs(truth[plain.train]).mean()


@pytest.mark.parametrize("mask_mode", ["none", "ignore", "composite"])
def test_resume_is_bit_equal(photos: Any, tmp_path: Path, mask_mode: str) -> None:
    """Oracle: all tensors and other state of an uninterrupted run, with other threads."""
    rng = np.random.default_rng(0)
    masks = [(rng.random((48, 48)) * 255).astype(np.uint8) for _ in photos.images]
    photos = replace(photos, masks=masks, mask_mode=mask_mode)
    config = replace(CONFIG, threads=1)

    def begun() -> Trainer:
        return Trainer(
            config, Analysis(photos=photos, gains=PhotoGains(photos.train, some_gains(photos)))
        )

    whole = begun()
    for step in range(1, 41):
        whole.step()
        if step in (1, 13, 21):
            checkpoint.save(tmp_path / f"{step}.safetensors", whole, {})
    for stop in (1, 13, 21):
        found = checkpoint.load(tmp_path / f"{stop}.safetensors")
        resumed = Trainer(replace(config, threads=2), Analysis(photos=photos))
        resumed.restore(found.trainer, found.tensors)
        while resumed.steps < 40:
            resumed.step()
        assert resumed.state() == whole.state()
        mine, theirs = resumed.tensors(), whole.tensors()
        assert mine.keys() == theirs.keys()
        assert all(torch.equal(tensor, theirs[name]) for name, tensor in mine.items())


def test_a_run_that_began_without_goes_on_without(photos: Any) -> None:
    """Oracle: a checkpoint without gains, loaded by a trainer with gains."""
    plain = Trainer(CONFIG, Analysis(photos=photos))
    plain.step()
    state, tensors = plain.state(), {k: t.clone() for k, t in plain.tensors().items()}
    other = Trainer(
        CONFIG, Analysis(photos=photos, gains=PhotoGains(photos.train, some_gains(photos)))
    )
    other.restore(state, tensors)
    plain.step()
    other.step()
    assert other.photo_parameters.gains is None
    assert torch.equal(other.model.params["means"], plain.model.params["means"])


def test_fixed_gains_stay_so_without_the_file_they_came_from(photos: Any) -> None:
    """Oracle: a checkpoint of fixed gains, restored by a trainer whose own gains learn."""
    fixed = PhotoGains(photos.train, some_gains(photos), fixed=True)
    learning = PhotoGains(photos.train, some_gains(photos))
    for gains in (fixed, learning):
        other = Trainer(CONFIG, Analysis(photos=photos, gains=learning)).photo_parameters
        count = len(photos.scene.cameras.names)
        other.restore(photos.train, count, gains.arrays())
        assert other.gains is not None
        assert other.gains.fixed == gains.fixed


@pytest.mark.parametrize(
    "damage",
    [
        {"gain/value": np.zeros((3, 3))},
        {"gain/moments": np.zeros((2, 8, 3), np.float32)},
        {"gain/moments": np.full((2, 8, 3), np.nan)},
        {"gain/steps": np.full(8, -1)},
        {"gain/steps": np.zeros(7, np.int64)},
    ],
)
def test_a_damaged_checkpoint_is_refused(photos: Any, damage: dict[str, np.ndarray]) -> None:
    """Oracle: the exception that becomes a FormatError."""
    gains = PhotoGains(photos.train, some_gains(photos))
    with pytest.raises(ValueError, match="gain/"):
        PhotoGains.restored(photos.train, 8, gains.arrays() | damage)


def test_bright_parts_are_those_of_short_exposures(make_photos: Callable[..., Any]) -> None:
    """Photos of a capture that is 1.7 times as bright, of which only every third shows all below
    white. Oracle: the capture; where it is brighter than white, splats are too."""
    plain = make_photos(held_out=())
    stops = np.resize(np.log([1 / 1.7, 1.0, 1.7]), len(plain.scene.cameras))
    stops = np.repeat((stops - stops.mean())[:, None], 3, axis=1)
    photos = exposed(plain, stops + np.log(1.7))
    config = replace(CONFIG, iterations=1600, background=Background.BLACK, sh_degree=0)
    gains = PhotoGains(photos.train, stops, fixed=True)
    trainer = Trainer(config, Analysis(photos=photos, gains=gains))
    for _ in range(config.iterations):
        trainer.step()
    cameras, splats, ratios = plain.scene.cameras, trainer.splats(), []
    for i in range(len(cameras)):
        truth = 1.7 / 255 * plain.images[i].astype(np.float64)
        height, width = truth.shape[:2]
        drawn = gscore.render(splats, cameras.Ks[i], cameras.viewmats[i], width, height).rgb
        ratios.append((drawn / np.maximum(truth, 1e-6))[truth > 1.2])
    found = np.concatenate(ratios)
    assert len(found) > 100
    assert abs(np.median(found) - 1) < 0.1
