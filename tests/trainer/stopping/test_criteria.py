"""Runs that end by quality; oracle: separate evaluations, and runs without goals."""

import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from gscore.config import DataConfig, TrainConfig
from gscore.events import Done, Eval, Event
from gscore.io.runs import read_run
from gscore.metrics.image import psnr
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.evaluation import Evaluator
from gscore.trainer.run import train
from gscore.trainer.stopping.controller import StoppingCriteria
from gscore.trainer.trainer import Trainer

pytestmark = pytest.mark.usefixtures("fake_engine")

CONFIG = TrainConfig(iterations=200, max_splats=200, checkpoint_seconds=0, coarse_factor=1)


def run(capture: Path, out: Path, config: TrainConfig, **options: Any) -> tuple[Any, list[Event]]:
    events: list[Event] = []
    data = DataConfig(source=capture, test_every=4, eval=True)
    return train(config, data, out, events.append, **options), events


@pytest.mark.usefixtures("real_engine")
def test_a_target_ends_the_run(capture: Path, tmp_path: Path) -> None:
    """Oracle: PSNRs of a run without a target, measured at the same steps."""
    plain, events = run(
        capture, tmp_path / "plain", replace(CONFIG, test_iterations=tuple(range(25, 200, 25)))
    )
    course = {e.step: e.metrics["psnr"] for e in events if isinstance(e, Eval)}
    target = max(course.values()) - 0.3
    end = min(step for step, value in course.items() if value >= target)
    assert 25 < end < 200
    result, events = run(capture, tmp_path / "goal", replace(CONFIG, target_psnr=target))
    assert (result.reason, result.steps) == ("target", end)
    assert result.metrics["reason"] == "target"
    same, _ = run(capture, tmp_path / "goal", replace(CONFIG, target_psnr=target), resume=True)
    assert (same.reason, same.steps) == ("target", end), "there is nothing left to do"
    assert result.metrics["psnr"] == pytest.approx(course[end], abs=1e-6)
    measured = {e.step: e.metrics["psnr"] for e in events if isinstance(e, Eval)}
    assert sorted(measured) == list(range(25, end + 1, 25))
    assert all(value == pytest.approx(course[step], abs=1e-6) for step, value in measured.items())
    assert isinstance(events[-1], Done)
    info = read_run(tmp_path / "goal")
    assert info is not None
    assert info.finished
    assert not info.resumable
    again, _ = run(capture, tmp_path / "goal", replace(CONFIG, target_psnr=0.0), resume=True)
    assert again.steps == 200
    for name in ("means", "opacities", "sh0"):
        assert np.array_equal(getattr(again.splats, name), getattr(plain.splats, name))


def goals_of(photos: Any, course: Callable[[int], float], config: TrainConfig) -> StoppingCriteria:
    """Goals of a trainer that has taken all steps and measures `course`, up to its end."""
    trainer = Trainer(config, Analysis(photos=photos))
    goals = StoppingCriteria(config, trainer, Evaluator(trainer, lpips=None, lpips_reason=""))
    for step in range(1, config.iterations + 1):
        trainer.counts.steps = step
        if goals.due():
            goals._measured.append((step, course(step)))
            if goals.converged():
                break
    return goals


def test_only_pixels_that_count_are_measured(make_photos: Callable[..., Any]) -> None:
    """Oracle: PSNR of the counted columns of the first pictures; an entirely hidden view."""
    photos = make_photos()
    photos.mask_mode = "ignore"
    photos.masks = [np.zeros((48, 48), np.uint8) for _ in photos.images]
    for mask in photos.masks[:-1]:
        mask[:, 10:] = 255
    trainer = Trainer(CONFIG, Analysis(photos=photos))
    evaluator = Evaluator(trainer, lpips=None, lpips_reason="")
    found = StoppingCriteria(CONFIG, trainer, evaluator).measure()
    seen = [i for i in evaluator.indices if photos.masks[i].any()]
    want = [psnr(evaluator.picture(i)[:, 10:], photos.images[i][:, 10:]) for i in seen]
    assert len(seen) < len(evaluator.indices)
    assert found == pytest.approx(np.mean(want), abs=1e-9)
    squares = [10 ** (-value / 10) for value in want] + [0.0]
    assert len(trainer.sampler.indices) == len(squares), "so all views are looked at"
    assert trainer.error() ** 2 == pytest.approx(np.mean(squares), rel=1e-5)


def test_converged_means_flat(photos: Any) -> None:
    """Oracle: courses with a known kink."""
    config = replace(CONFIG, iterations=4000, early_stop=True)
    rising = goals_of(photos, lambda step: 20 + step / 1000, config)
    assert rising.length == 0
    bent = goals_of(photos, lambda step: 20 + min(step, 2000) / 200, config)
    assert 1.25 * 2400 <= bent.length <= 1.25 * 2900
    falling = goals_of(photos, lambda step: 30 - step / 1000, config)
    assert 0 < falling.length < 1500


def test_small_photos_have_not_converged(photos: Any) -> None:
    """Oracle: a flat course, which ends with photos at full size and not before."""
    config = replace(CONFIG, iterations=4000, early_stop=True, coarse_factor=4, coarse_until=0.5)
    flat = goals_of(photos, lambda step: 20.0, config)
    plan = Trainer(config, Analysis(photos=photos)).plan
    full_size = next(step for step in range(1, 4001) if plan.factor_at(step) == 1)
    assert full_size <= 0.8 * flat.length <= full_size + 200
    at_once = goals_of(photos, lambda step: 20.0, replace(config, coarse_factor=1))
    assert at_once.length < 0.6 * flat.length


def test_early_stop_resumes_to_the_same_end(capture: Path, tmp_path: Path) -> None:
    """Oracle: bit equality with the uninterrupted run; no improvement at a rate of 0."""
    still = replace(
        CONFIG,
        iterations=1000,
        early_stop=True,
        means_lr=0.0,
        means_lr_final=0.0,
        sh0_lr=1e-9,
        opacities_lr=1e-9,
        scales_lr=1e-9,
        quats_lr=1e-9,
        refine_stop=1,
        checkpoint_iterations=(210,),
    )
    whole, _ = run(capture, tmp_path / "whole", still)
    assert whole.reason == "converged"
    assert whole.steps < 400
    half = tmp_path / "whole" / "checkpoints" / "step_00000210.safetensors"
    resumed, _ = run(capture, tmp_path / "resumed", still, start_checkpoint=half)
    assert (resumed.reason, resumed.steps) == (whole.reason, whole.steps)
    assert np.array_equal(resumed.splats.sh0, whole.splats.sh0)


def test_time_budget_of_a_run(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: a clock with 5 ms for every step; a resumed run has the rest of the budget. Lengths
    are planned from few steps, so they meet it to a tenth or so."""
    ticks = itertools.count()
    clock = SimpleNamespace(perf_counter=lambda: next(ticks) * 0.005)
    monkeypatch.setattr("gscore.trainer.session.time", clock)
    config = replace(CONFIG, time_budget=1.0)
    result, _ = run(capture, tmp_path / "out", config)
    assert result.reason == "finished"
    assert result.train_seconds == pytest.approx(1.0, abs=0.1)
    assert result.steps == round(result.train_seconds / 0.005)
    info = read_run(tmp_path / "out")
    assert info is not None
    assert info.finished
    longer, _ = run(capture, tmp_path / "out", replace(config, time_budget=1.5), resume=True)
    assert longer.train_seconds == pytest.approx(1.5, abs=0.1)
    assert longer.steps == round(longer.train_seconds / 0.005)
    few, _ = run(capture, tmp_path / "few", replace(config, iterations=3))
    assert few.train_seconds == pytest.approx(1.0, abs=0.1), "a budget knows no number of steps"
