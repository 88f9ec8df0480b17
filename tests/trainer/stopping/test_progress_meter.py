"""Progress figures of a run; oracle: a run with made-up times."""

import math

import pytest

from gscore.config import TrainConfig
from gscore.engine.gpu.engine import CARD_COST
from gscore.trainer.estimate.cost import Cost
from gscore.trainer.schedule.plan import Plan
from gscore.trainer.stopping.progress_meter import ProgressMeter


def test_the_time_left_holds_while_photos_grow() -> None:
    """Oracle: steps that take exactly their predicted share of the work."""
    config = TrainConfig(iterations=2000, max_splats=100)
    plan = Plan.of(config, extent=1.0, points=100, side=600, pixels=360_000)
    seconds = [3 * Cost(plan).seconds_at(step, 100) for step in range(1, 2001)]
    meter = ProgressMeter(plan, splats=100, pace=3.0)
    for step, spent in enumerate(seconds, start=1):
        meter.update(step=step, loss=0.1, mse=0.01, splats=100, seconds=spent)
        left = sum(seconds[step:])
        assert meter.progress().eta_s == pytest.approx(left, rel=0.02, abs=1e-9)
    assert meter.train_seconds == pytest.approx(sum(seconds))
    assert meter.progress().psnr == pytest.approx(20)
    assert seconds[0] < 0.35 * seconds[-1], "else the time left would be easy to tell"


def test_measured_pace_replaces_the_forecast() -> None:
    """Oracle: a machine of half the predicted speed and a first step a hundred times as long; the
    time left is known to a tenth after a tenth of the work, and never reported as double."""
    config = TrainConfig(iterations=2000, max_splats=100)
    plan = Plan.of(config, extent=1.0, points=100, side=600, pixels=360_000)
    planned = [Cost(plan).seconds_at(step, 100) for step in range(1, 2001)]
    seconds = [2 * planned[0] * 100, *(2 * each for each in planned[1:])]
    meter = ProgressMeter(plan, splats=100, pace=1.0)
    for step, spent in enumerate(seconds, start=1):
        meter.update(step=step, loss=0.1, mse=0.01, splats=100, seconds=spent)
        left, messages = sum(seconds[step:]), meter.progress().eta_s
        assert 0.5 * left <= messages * (1 + 1e-9) and messages <= 2 * left + 1e-9
        if sum(planned[:step]) > 0.1 * sum(planned):
            assert messages == pytest.approx(left, rel=0.1, abs=1e-9)
        if sum(planned[:step]) > 0.25 * sum(planned):
            assert messages == pytest.approx(left, rel=0.02, abs=1e-9)


def test_ten_steps_replace_the_guess_of_a_card() -> None:
    """Oracle: a card whose steps take twenty times as long as guessed; the time left is known to a
    tenth after 150 steps, also where photos and splats grow."""
    config = TrainConfig(iterations=2000, max_splats=100)
    plan = Plan.of(config, extent=1.0, points=100, side=600, pixels=360_000)
    cost = Cost(plan, CARD_COST)
    seconds = [20 * cost.seconds_at(step, 100) for step in range(1, 2001)]
    meter = ProgressMeter(plan, splats=100, cost=CARD_COST)
    for step, spent in enumerate(seconds, start=1):
        meter.update(step=step, loss=0.1, mse=0.01, splats=100, seconds=spent)
        if step == 15:
            assert meter.pace > 10
        if step >= 150:
            left = sum(seconds[step:])
            assert meter.progress().eta_s == pytest.approx(left, rel=0.1, abs=1e-9)


def test_remaining_time_is_steady_under_changing_load() -> None:
    """Oracle: steps three times as long as planned in every other half second, and as planned in
    between; a mean of the last fifty steps jumps between both."""
    config = TrainConfig(iterations=4000, max_splats=100)
    plan = Plan.of(config, extent=1.0, points=100, side=600, pixels=360_000)
    planned = [Cost(plan).seconds_at(step, 100) for step in range(1, 4001)]
    seconds, clock = [], 0.0
    for each in planned:
        seconds.append(each * (3 if clock % 1 < 0.5 else 1))
        clock += seconds[-1]
    meter, messages = ProgressMeter(plan, splats=100), []
    for step, spent in enumerate(seconds, start=1):
        meter.update(step=step, loss=0.1, mse=0.01, splats=100, seconds=spent)
        if 5 < meter.train_seconds < 0.9 * clock:
            messages.append(meter.progress().eta_s / sum(seconds[step:]))
    assert len(messages) > 1000 and min(messages) > 0.75 and max(messages) < 1.35


def test_no_more_time_is_left_than_the_budget() -> None:
    """Oracle: the definition; a plan of a far longer time."""
    plan = Plan.of(TrainConfig(iterations=2000), extent=1.0, points=100, side=600, pixels=360_000)
    meter = ProgressMeter(plan, splats=100, budget=1.0)
    for step, left in ((1, 0.75), (2, 0.5), (5, 0.0)):
        meter.update(step=step, loss=0.1, mse=0.01, splats=100, seconds=0.25 * (1 + (step == 5)))
        assert meter.progress().eta_s == pytest.approx(left)


def test_a_resumed_run_stands_where_it_stood() -> None:
    """Oracle: the same meter without the stop."""
    config = TrainConfig(iterations=2000, max_splats=5000)
    plan = Plan.of(config, extent=1.0, points=100, side=600, pixels=360_000)
    meter, resumed = ProgressMeter(plan, splats=100), ProgressMeter(plan, splats=100)
    for step in range(1, 61):
        meter.update(step=step, loss=0.1, mse=0.01, splats=100 + step, seconds=0.01)
    resumed.restore(meter.state())
    there, here = meter.progress(), resumed.progress()
    assert (here.step, here.splats) == (there.step, there.splats) == (60, 160)
    assert here.eta_s == pytest.approx(there.eta_s)
    resumed.rewind(40, splats=140)
    assert (resumed.progress().step, resumed.progress().splats) == (40, 140)


def test_steps_that_are_taken_anew_are_forgotten_but_not_how_fast_they_were() -> None:
    """Oracle: by hand: steps three times as long as planned, one of them a hundred times; after the
    rewind the same pace is expected, with the low confidence of the start."""
    config = TrainConfig(iterations=2000, max_splats=100)
    plan = Plan.of(config, extent=1.0, points=100, side=600, pixels=360_000)
    meter = ProgressMeter(plan, splats=100)

    def take(first: int, last: int, pace: float) -> None:
        for step in range(first, last + 1):
            seconds = pace * Cost(plan).seconds_at(step, 100)
            meter.update(step=step, loss=0.1, mse=0.01, splats=100, seconds=seconds)

    take(1, 1200, 3.0)
    assert meter.pace == pytest.approx(3, rel=0.05)
    take(1201, 1201, 300.0)
    assert 3.5 < (known := meter.pace) < 6, "a mean of many steps"
    meter.rewind(40, splats=100)
    assert meter.pace == pytest.approx(known)
    left = Cost(plan).seconds_after(40, 100)
    assert meter.progress().eta_s == pytest.approx(known * left)
    assert [entry["step"] for entry in meter.history] == list(range(4, 41, 4))
    assert meter.state()["pace"] == pytest.approx(known)
    take(41, 41, 300.0)
    done = Cost(plan).seconds_at(41, 100)
    kept = 0.5 * math.exp(-done / max(2, 0.1 * left))
    assert meter.pace == pytest.approx((kept * known + 300 * done) / (kept + done))
