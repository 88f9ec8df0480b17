"""Models that are trained in parallel and merged."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from gscore.config import Background, Stereo, Strategy, Switch, TrainConfig
from gscore.engine.cpu import loss as step_loss
from gscore.engine.ensemble import divide_opacities
from gscore.events import Decision
from gscore.presets import PRESETS
from gscore.raster.api import render
from gscore.raster.loss import LossValues
from gscore.splats import PARAMETERS, Splats
from gscore.trainer.analysis import photo_rules
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.estimate.cost import Cost
from gscore.trainer.model.ensemble_member import count_members
from gscore.trainer.photos.sky_search import cells_of, decide_sky, sky_views
from gscore.trainer.photos.view_sampler import ViewSampler
from gscore.trainer.schedule.caps import expected_model_count, model_count
from gscore.trainer.trainer import Trainer
from tests.trainer.short_run import CONFIG

ONE = replace(CONFIG, max_splats=200, sh_degree=1, prune_share=0.2, background=Background.AUTO)
"""Draws no random number but the order of the views, so that runs can be compared."""
TWO = replace(ONE, ensemble=2, max_splats=400)
RANDOM = replace(TWO, drop_rate=0.2, seed=3)


def bits(tensors: dict[str, torch.Tensor]) -> dict[str, bytes]:
    return {name: t.contiguous().numpy().tobytes() for name, t in tensors.items()}


def trained(config: TrainConfig, photos: Any, steps: int = 60) -> Trainer:
    trainer = Trainer(config, Analysis(photos=photos))
    for _ in range(steps):
        trainer.step()
    return trainer


def test_each_model_is_as_if_it_were_trained_alone(
    photos: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: runs of one model with half the splats, the second with the views of another half
    epoch; to the bit."""
    both = trained(TWO, photos)
    batch_neighbours = ViewSampler.batch_neighbours
    for place, member in enumerate(both.models.members):
        monkeypatch.setattr(
            ViewSampler,
            "batch_neighbours",
            lambda self, parts, k=place: [batch_neighbours(self, 2)[k]],
        )
        alone = trained(ONE, photos)
        mine = {key.removeprefix(f"{place}/"): t for key, t in member.tensors().items()}
        assert bits(mine) == bits(alone.models.members[0].tensors())
        assert len(member.model) > 100
    first, second = (member.model.params["means"] for member in both.models.members)
    assert first.shape != second.shape or not torch.equal(first, second)


def test_each_model_sees_each_view_once_an_epoch() -> None:
    """Oracle: the set of views; different views at each step; a correct prediction of the next
    ones."""
    sampler, generator = ViewSampler(range(7)), torch.Generator(device="cpu").manual_seed(1)
    seen: list[list[int]] = []
    for place in range(7):
        ahead = sampler.upcoming(1, 3)
        sampler.next(generator)
        seen.append(sampler.batch_neighbours(3))
        assert ahead == ([seen[-1]] if place else []), "an epoch is not drawn before it begins"
        assert seen[-1][0] == sampler.order[sampler.position - 1]
        assert len(set(seen[-1])) == 3
    assert all(sorted(views) == list(range(7)) for views in zip(*seen, strict=True))


def light_taken(opacity: float) -> float:
    """Optical depth of a round splat where it is drawn, summed ring by ring, float64."""
    if opacity <= 1 / 255:
        return 0.0
    radii = np.linspace(0, math.sqrt(2 * math.log(255 * opacity)), 20_001)
    rings = -np.log1p(-opacity * np.exp(-0.5 * radii**2)) * radii
    return float(((rings[1:] + rings[:-1]) / 2 * np.diff(radii)).sum())


@pytest.mark.parametrize("models", [2, 3, 8])
def test_as_many_splats_in_one_place_take_as_much_light_as_one_did(models: int) -> None:
    """Oracle: optical depths of rings; undrawn splats stay, drawn ones are still drawn."""
    for opacity in (0.0045, 0.01, 0.1, 0.5, 0.9, 0.99):
        logit = torch.logit(torch.tensor([opacity])).numpy()
        shared = float(1 / (1 + np.exp(-divide_opacities(logit, models).astype(np.float64)[0])))
        assert 1 / 255 < shared < opacity
        assert models * light_taken(shared) == pytest.approx(light_taken(opacity), rel=2e-3)
    extremes = np.array([-200.0, -6.0, 30.0, 200.0], np.float32)
    shared = divide_opacities(extremes, models)
    assert np.isfinite(shared).all()
    assert np.isnan(divide_opacities(np.array([np.nan], np.float32), models)).all()
    assert np.array_equal(shared[:2], extremes[:2])
    assert divide_opacities(extremes, 1) is extremes


def test_rendered_ensemble_equals_the_written_splats(
    photos: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the renderer on the merged splats; the same splats in parts and as a whole."""
    monkeypatch.setattr("gscore.trainer.step.model_set._ROWS_A_PART", 70)
    trainer = trained(RANDOM, photos, 30)
    whole, parts = trainer.splats(), list(trainer.models.parts())
    for name in PARAMETERS:
        joined = np.concatenate([getattr(part, name) for part in parts])
        assert np.array_equal(joined, getattr(whole, name)), name
    assert len(whole) == trainer.splat_count == sum(len(m.model) for m in trainer.models.members)
    cameras = photos.scene.cameras
    picture = trainer.renderer.picture(0, background=(0.0, 0.0, 0.0))
    size = int(cameras.widths[0]), int(cameras.heights[0])
    drawn = render(whole, cameras.Ks[0], cameras.viewmats[0], *size).rgb
    np.testing.assert_allclose(picture, drawn, atol=2e-5)
    ended = trainer.finish()
    for name in PARAMETERS:
        assert np.array_equal(getattr(ended, name), getattr(whole, name)), name
    assert np.array_equal(trainer.renderer.picture(0, background=(0.0, 0.0, 0.0)), picture)


def test_it_shows_the_mean_of_its_models(make_photos: Callable[..., Any]) -> None:
    """Oracle: the mean of the pictures of both; the better model alone is further from it."""
    photos = make_photos()
    trainer = trained(replace(RANDOM, iterations=400, max_splats=800), photos, 400)
    cameras = photos.scene.cameras

    def drawn(splats: Splats) -> np.ndarray:
        size = int(cameras.widths[1]), int(cameras.heights[1])
        return render(splats, cameras.Ks[1], cameras.viewmats[1], *size).rgb

    alone = [
        trainer.models.in_world(member.model.part(0, len(member.model)))
        for member in trainer.models.members
    ]
    pictures = [drawn(splats) for splats in alone]
    mean, shown = (pictures[0] + pictures[1]) / 2, drawn(trainer.splats())
    error = float(np.abs(shown - mean).mean())
    assert error < 0.8 * min(float(np.abs(picture - mean).mean()) for picture in pictures)


@pytest.mark.parametrize("strategy", list(Strategy))
def test_same_bits_for_any_number_of_threads_and_after_going_on(
    photos: Any, strategy: Strategy
) -> None:
    """Oracle: bit equality of all state after 60 steps, and of a run that goes on from step 33."""
    config = replace(RANDOM, strategy=strategy)
    once, threads = trained(config, photos), trained(replace(config, threads=3), photos)
    begun, after = trained(config, photos, 33), Trainer(config, Analysis(photos=photos))
    after.restore(begun.state(), {name: t.clone() for name, t in begun.tensors().items()})
    for _ in range(27):
        after.step()
    assert bits(once.tensors()) == bits(threads.tensors()) == bits(after.tensors())
    assert once.state() == after.state()
    assert count_members(once.tensors()) == 2


@pytest.mark.parametrize("models", [1, 2])
def test_a_run_keeps_the_models_that_photos_decided_on(
    photos: Any, monkeypatch: pytest.MonkeyPatch, models: int
) -> None:
    """Oracle: bit equality with the uninterrupted run, though the rule now finds another number."""
    config = replace(TWO, ensemble_below=0.35)
    monkeypatch.setattr(
        photo_rules, "model_count", lambda *_, **__: (models, Decision("ensemble", "then"))
    )
    begun = trained(config, photos, 20)
    state, tensors = begun.state(), {name: t.clone() for name, t in begun.tensors().items()}
    for _ in range(15):
        begun.step()
    monkeypatch.setattr(photo_rules, "model_count", lambda *_, **__: (3 - models, None))
    after = Trainer(config, Analysis(photos=photos))
    after.restore(state, tensors)
    for _ in range(15):
        after.step()
    assert bits(after.tensors()) == bits(begun.tensors())
    assert (after.plan.models, after.rules.by_photos) == (models, ())


def test_a_state_of_other_models_is_refused(photos: Any) -> None:
    """Oracle: the sentence; no part of the state is loaded."""
    one, two = trained(ONE, photos, 3), trained(TWO, photos, 3)
    before = bits(two.tensors())
    with pytest.raises(ValueError, match="it has 1 models, expected 2"):
        two.restore(one.state(), one.tensors())
    assert bits(two.tensors()) == before
    broken = dict(two.tensors())
    broken["1/param/means"] = broken["1/param/means"][1:].clone()
    with pytest.raises(ValueError, match="float32, got"):
        two.restore(two.state(), broken)
    other = dict(two.tensors())
    for kind in ("param", "m1", "m2", "gathered"):
        other[f"1/{kind}/shN"] = torch.zeros(len(two.models.members[1].model), 3, 3)
    with pytest.raises(ValueError, match="different SH degrees"):
        two.restore(two.state(), other)
    assert bits(two.tensors()) == before


def test_where_one_loss_is_not_finite_the_other_model_takes_its_step(
    photos: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the bits of a run with finite losses, and those before the step."""
    well, ill = Trainer(TWO, Analysis(photos=photos)), Trainer(TWO, Analysis(photos=photos))
    before = bits(ill.models.members[1].tensors())
    found = step_loss.image_loss_gradient
    bad = iter((False, True))

    def once(*arguments: Any, **options: Any) -> LossValues:
        loss = found(*arguments, **options)
        return replace(loss, loss=math.nan) if next(bad) else loss

    well.step()
    monkeypatch.setattr(step_loss, "image_loss_gradient", once)
    assert ill.step().skipped
    assert bits(ill.models.members[0].tensors()) == bits(well.models.members[0].tensors())
    assert bits(ill.models.members[1].tensors()) == before


@pytest.mark.parametrize(
    ("ensemble", "below", "known", "mask_mode", "points", "models"),
    [
        (2, 0.35, 0.25, "none", 9000, 2),
        (3, 0.35, 0.25, "ignore", 9000, 3),
        (2, 0.35, 0.25, "none", 0, 2),
        (2, 0.35, 0.25, "none", 100_000, 2),
        (2, 0.35, 0.25, "none", 100_001, 1),
        (2, 0.35, 0.35, "none", 9000, 1),
        (2, 0.35, None, "none", 9000, 1),
        (2, 0.35, 0.25, "composite", 9000, 1),
        (2, 0.35, 0.74, "composite", 9000, 1),
        (2, 0.35, None, "composite", 9000, 1),
        (2, 0.35, 0.75, "composite", 9000, 2),
        (2, 0.35, 0.9, "composite", 100_001, 1),
        (2, 0.0, 0.9, "composite", 500_000, 2),
        (2, 0.0, None, "none", 9000, 2),
        (1, 0.35, 0.1, "none", 9000, 1),
    ],
)
def test_how_many_models_there_are(
    ensemble: int, below: float, known: float | None, mask_mode: str, points: int, models: int
) -> None:
    """Oracle: the text of the options, 400,000 splats at most; the sentence that comes with the
    condition; an expectation before photos are compared that is no less, but for a subject; one
    model for a subject without dropout."""
    config = TrainConfig(ensemble=ensemble, ensemble_below=below, stereo=Stereo.AUTO, drop_rate=0.1)
    found, decision = model_count(
        config, photos=50, mask_mode=mask_mode, known=known, points=points
    )
    subject = mask_mode == "composite"
    expected = expected_model_count(config, photos=50, points=points, subject=subject)
    assert expected == 1 if subject and below else expected >= models
    whole = replace(config, drop_rate=0.0)
    alone, _ = model_count(whole, photos=50, mask_mode=mask_mode, known=known, points=points)
    assert alone == (1 if subject and below else models)
    off = replace(config, stereo=Stereo.OFF, start_splats=None)
    unasked = expected_model_count(off, photos=50, points=points, subject=False)
    assert unasked == (1 if below else ensemble)
    given = replace(config, start_splats=Path("x.ply"))
    assert expected_model_count(given, photos=50, points=points, subject=False) == 1
    assert found == models
    assert (decision is not None) == (models > 1 and below > 0)
    if decision is not None:
        whose = "75% of the subject's pixels," if subject else "25% of their pixels, less"
        assert f"the depth of {whose}" in decision.text and f"{models} models" in decision.text
        assert decision.topic == "ensemble"


def test_which_presets_train_several() -> None:
    """Oracle: the presets with stereo, without which the condition is never met."""
    found = {name: make(Path())[1] for name, make in PRESETS.items()}
    models = {name: (config.ensemble, config.ensemble_below) for name, config in found.items()}
    assert models == dict.fromkeys(("preview", "draft"), (1, 0)) | {
        "normal": (2, 0.35),
        "high": (3, 0.35),
        "highest": (3, 0.35),
    }


def test_given_splats_are_one_model(photos: Any) -> None:
    """Oracle: the number of given splats."""
    start = trained(ONE, photos, 20).splats()
    assert Trainer(
        replace(TWO, start_splats=Path("x.ply")), Analysis(photos=photos, start=start)
    ).splat_count == len(start)


def test_models_share_the_splats_and_cost_more(photos: Any) -> None:
    """Oracle: halves; the initial splats of two runs; a step of two models of half the splats costs
    more than one of them and less than twice that of one with all."""
    one, two = (
        Trainer(replace(TWO, ensemble=1), Analysis(photos=photos)),
        Trainer(TWO, Analysis(photos=photos)),
    )
    assert two.plan.max_splats == 200 and one.plan.max_splats == 400
    assert two.splat_count == 2 * one.splat_count
    costs = [Cost(trainer.plan).seconds_at(50, 400) for trainer in (one, two)]
    assert costs[0] < costs[1] < 2 * costs[0]
    grown = Cost(two.plan).splats_at(60, 0, two.splat_count)
    assert two.splat_count < grown <= 400


@pytest.mark.parametrize("sky", [Switch.OFF, Switch.ON])
def test_no_more_splats_start_than_are_allowed(photos: Any, sky: Switch) -> None:
    """Oracle: 150 points; the limit, shared by the models."""
    for models, most in ((2, 60), (3, 60), (2, 5)):
        config = replace(TWO, ensemble=models, max_splats=most, sky=sky)
        cells = {view: cells_of(photos.image(view), None) for view in sky_views(config, photos)}
        found, _ = decide_sky(config, photos, cells, is_part=False)
        trainer = Trainer(config, Analysis(photos=photos, sky=found))
        assert models <= trainer.splat_count <= max(most, models)


def test_pictures_between_steps_are_of_the_splats_there_are(photos: Any) -> None:
    """Oracle: a trainer without earlier pictures."""
    looked, fresh = (
        Trainer(RANDOM, Analysis(photos=photos)),
        Trainer(RANDOM, Analysis(photos=photos)),
    )
    for _ in range(3):
        looked.renderer.picture(0, background=(0.0, 0.0, 0.0))
        looked.step()
        fresh.step()
    ours, theirs = (t.renderer.picture(0, background=(0.0, 0.0, 0.0)) for t in (looked, fresh))
    assert np.array_equal(ours, theirs)
