"""Schedules; oracle: the values in the papers for their run lengths."""

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

from gscore.config import Strategy, TrainConfig
from gscore.presets import PRESETS
from gscore.trainer.estimate.cost import Cost
from gscore.trainer.schedule.plan import Plan


def plan_of(config: TrainConfig, points: int = 10_000, side: int = 300) -> Plan:
    return Plan.of(config, extent=2.0, points=points, side=side, pixels=side * side)


def test_a_run_of_30000_steps_is_that_of_the_paper() -> None:
    """Oracle: Kerbl et al. 2023 and its reference code, for growth that does not wait for
    photos."""
    plan = plan_of(TrainConfig(iterations=30_000, grow_with_photos=False))
    assert [step for step in range(1, 30_001) if plan.resets_at(step)] == [
        3000 * k for k in range(1, 6)
    ]
    waits = plan_of(TrainConfig(iterations=30_000))
    assert waits.refine_stop == 24_000
    assert not any(waits.resets_at(step) for step in range(15_001, 30_001))
    longer = plan_of(TrainConfig(iterations=30_000, refine_stop=20_000))
    assert longer.resets_at(18_000) and not longer.resets_at(21_000)
    assert (plan.refine_start, plan.refine_stop, plan.refine_every) == (500, 15_000, 100)
    assert (plan.reset_every, plan.sh_every) == (3000, 1000)
    assert plan.rates["opacities"] == 0.025
    assert [plan.sh_degree_at(s) for s in (1, 1000, 1001, 2001, 3001, 30_000)] == [0, 0, 1, 2, 3, 3]
    assert plan.means_lr_at(30_000) == pytest.approx(2 * 1.6e-6)
    assert plan.means_lr_at(15_000) == pytest.approx(2 * 1.6e-5)


def test_splats_grow_with_the_photos() -> None:
    """Oracle: by hand, linear in the sides: 1,000 at a quarter of them, 10,000 at full size."""
    config = TrainConfig(
        iterations=1000, max_splats=10_000, coarse_factor=4.0, grow_with_photos=True
    )
    plan = plan_of(config, points=1000)
    full_size = next(step for step in range(1, 1001) if plan.factor_at(step) == 1.0)
    assert plan.refine_stop == pytest.approx(full_size + 2 * plan.refine_every, abs=1)
    caps = {plan.factor_at(step): plan.cap_for(plan.factor_at(step)) for step in range(1, 1001)}
    assert caps == {
        4.0: 1000,
        2.0**1.5: pytest.approx(2243, abs=1),
        2.0: 4000,
        2.0**0.5: pytest.approx(6485, abs=1),
        1.0: 10_000,
    }
    at_once = plan_of(
        replace(config, grow_with_photos=False, refine_stop=plan.refine_stop), points=1000
    )
    assert Cost(plan).seconds_after(0, 1000) < Cost(at_once).seconds_after(0, 1000)


@pytest.mark.parametrize(("side", "first"), [(220, 2.0**1.5), (300, 4.0), (900, 8.0)])
def test_growth_with_photos_is_whole(side: int, first: float) -> None:
    """Oracle: the initial number at the first size, the cap at full size, and refinements until
    then."""
    config = TrainConfig(iterations=10_000, max_splats=50_000, grow_with_photos=True)
    plan = plan_of(config, points=5000, side=side)
    assert (plan.factor_at(1), plan.cap_for(plan.factor_at(1))) == (first, 5000)
    assert plan.cap_for(plan.factor_at(plan.refine_stop)) == 50_000
    given = replace(config, start_splats=Path("a.ply"))
    assert plan_of(given).refine_stop == 5000


@pytest.mark.parametrize(
    "config",
    [
        TrainConfig(iterations=1000, coarse_factor=4.0, grow_with_photos=False),
        TrainConfig(iterations=999, coarse_factor=4.0),
        TrainConfig(iterations=1000, coarse_factor=2.0),
        TrainConfig(iterations=1000, coarse_factor=4.0, strategy=Strategy.MCMC),
        TrainConfig(iterations=1000, coarse_factor=1.0),
    ],
)
def test_else_splats_grow_to_the_cap_at_once(config: TrainConfig) -> None:
    """Oracle: the cap, also for photos at full size from the first step."""
    plan, plain = plan_of(config), plan_of(replace(config, grow_with_photos=False))
    assert {plan.cap_for(plan.factor_at(step)) for step in range(1, 1001)} == {config.max_splats}
    assert plan.refine_stop == plain.refine_stop


def test_rates_fall_over_the_last_tenth() -> None:
    """Oracle: a fifth of the rate at the last step, its root halfway."""
    plan = plan_of(TrainConfig(iterations=1000))
    assert plan.rates_at(1) == plan.rates_at(900) == plan.rates
    for name, rate in plan.rates.items():
        assert plan.rates_at(950)[name] == pytest.approx(rate * 0.2**0.5)
        assert plan.rates_at(1000)[name] == pytest.approx(0.2 * rate)
        # A run that continues beyond its planned end keeps the last rate.
        assert plan.rates_at(1100)[name] == plan.rates_at(1000)[name]
    flat = plan_of(TrainConfig(iterations=1000, lr_final=1))
    assert flat.rates_at(1000) == flat.rates


def test_mcmc_of_30000_steps_is_that_of_the_paper() -> None:
    """Oracle: Kheradmand et al. 2024: refinement until 25 000, +5 %, other initial values."""
    plan = plan_of(TrainConfig(iterations=30_000, strategy=Strategy.MCMC))
    assert (plan.refine_stop, plan.mcmc_growth) == (25_000, 0.05)
    assert (plan.init_opacity, plan.init_scale, plan.rates["opacities"]) == (0.5, 0.1, 0.05)


def test_a_short_mcmc_run_grows_fast_enough() -> None:
    """Oracle: the cap, which compound growth reaches within the refinements."""
    config = TrainConfig(iterations=1500, strategy=Strategy.MCMC, max_splats=100_000)
    plan = plan_of(config, points=5000)
    count = 5000.0
    for step in range(1, 1501):
        if plan.refines_at(step):
            count *= 1 + plan.mcmc_growth
    assert count >= 100_000


@pytest.mark.parametrize("iterations", [1, 2, 50, 700, 3000, 7000, 100_000])
@pytest.mark.parametrize("strategy", list(Strategy))
def test_any_length_gives_a_sane_plan(iterations: int, strategy: Strategy) -> None:
    """Oracle: all SH degrees by half of the run, no refinement at or after the last step."""
    plan = plan_of(TrainConfig(iterations=iterations, strategy=strategy, lr_boost=1))
    if iterations >= 6:
        assert plan.sh_degree_at(iterations // 2 + 1) == 3
    assert not plan.refines_at(iterations)
    assert not plan.resets_at(iterations)
    assert plan.means_lr_at(0) == pytest.approx(3.2e-4)
    assert plan.means_lr_at(iterations) == pytest.approx(3.2e-6)
    steps = range(1, min(iterations, 8000))
    assert all(plan.means_lr_at(s) > plan.means_lr_at(s + 1) for s in steps)
    if iterations >= 700:
        assert sum(plan.refines_at(s) for s in steps) >= 5


def test_short_runs_learn_faster() -> None:
    """Oracle: 1 for the paper's length and beyond, rising to 4; roots and squares as documented."""
    paper, short = (plan_of(TrainConfig(iterations=n, shN_every=1)) for n in (30_000, 100))
    assert plan_of(TrainConfig(iterations=90_000, shN_every=1)).rates == paper.rates
    for name in ("quats", "scales", "sh0", "shN"):
        assert short.rates[name] == pytest.approx(4 * paper.rates[name])
    assert short.rates["opacities"] == pytest.approx(2 * paper.rates["opacities"])
    assert short.means_lr_at(0) == pytest.approx(2 * paper.means_lr_at(0))
    assert short.means_lr_at(100) == pytest.approx(16 * paper.means_lr_at(30_000))
    assert (paper.grow_grad, short.grow_grad) == (2e-4, 1e-4)
    scales = [
        plan_of(TrainConfig(iterations=n, shN_every=1)).rates["scales"]
        for n in (500, 2000, 9000, 29_000)
    ]
    assert scales == sorted(scales, reverse=True)


def test_long_runs_of_a_subject_grow_by_a_lower_threshold() -> None:
    """Oracle: 5e-5 from 10,000 steps on or with dropout, the option where set, the paper's value
    for all else."""

    def threshold(config: TrainConfig, subject: bool, drops: bool = False) -> float:
        of = {"extent": 1.0, "points": 9, "side": 300, "pixels": 90_000}
        return Plan.of(config, **of, subject=subject, drops=drops).grow_grad

    long, short = (TrainConfig(iterations=n) for n in (10_000, 9_999))
    assert threshold(long, True) == 5e-5
    assert threshold(long, False) == plan_of(long).grow_grad > 1e-4
    assert threshold(short, True) == plan_of(short).grow_grad > 1e-4
    assert threshold(short, True, drops=True) == 5e-5
    assert threshold(short, False, drops=True) == plan_of(short).grow_grad
    assert threshold(replace(long, grow_grad=3e-4), True) == 3e-4


def test_higher_coefficients_step_rarely_and_further() -> None:
    """Oracle: every eighth step, in runs under 1000 steps a 125th of them; the rate rises by the
    root; the last step is always included."""
    for n, every in ((30_000, 8), (1000, 8), (500, 4), (100, 1)):
        plan, each = (plan_of(TrainConfig(iterations=n, shN_every=e)) for e in (0, 1))
        assert plan.shN_every == every
        assert plan.rates["shN"] == pytest.approx(each.rates["shN"] * every**0.5)
        updates = [s for s in range(1, 17) if plan.harmonics_update_at(s)]
        assert updates == [*range(every, 17, every)]
        assert plan.harmonics_update_at(n)


def test_options_win_over_what_is_derived() -> None:
    """Oracle: the options."""
    config = TrainConfig(
        iterations=100, sh_every=7, refine_start=11, refine_stop=90, refine_every=13, reset_every=-1
    )
    plan = plan_of(config)
    assert (plan.sh_every, plan.refine_start, plan.refine_stop) == (7, 11, 90)
    assert [s for s in range(1, 101) if plan.refines_at(s)] == [13, 26, 39, 52, 65, 78]
    assert plan.reset_every == 0
    assert not any(plan.resets_at(s) for s in range(1, 101))


def test_opacities_are_not_reset_before_a_sky() -> None:
    """Oracle: the paper's 3,000 steps; none with a sky, unless requested."""
    config, facts = TrainConfig(iterations=9000), {"extent": 2.0, "points": 9, "pixels": 90_000}
    resets = [Plan.of(config, side=300, sky=sky, **facts).reset_every for sky in (False, True)]
    assert resets == [3000, 0]
    asked = replace(config, reset_every=500)
    assert Plan.of(asked, side=300, sky=True, **facts).reset_every == 500


def test_splats_in_front_of_the_sky_are_removed_now_and_then() -> None:
    """Oracle: every eighth refinement step, and the last step."""
    plan = plan_of(TrainConfig(iterations=230, refine_every=10))
    assert [s for s in range(1, 231) if plan.prunes_free_sky_at(s)] == [80, 160, 230]


def test_a_rate_of_zero_stays_zero() -> None:
    """Oracle: positions that stay, and a logarithm without errors."""
    plan = plan_of(TrainConfig(means_lr=0.0))
    assert plan.means_lr_at(500) == 0


def test_presets_spend_more_each_time(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Oracle: steps, splats and photo width rise from preview to highest."""
    made = [preset(tmp_path_factory.getbasetemp()) for preset in PRESETS.values()]
    assert list(PRESETS) == ["preview", "draft", "normal", "high", "highest"]
    for (data, train), (more_data, more_train) in pairwise(made):
        assert train.iterations < more_train.iterations
        assert train.max_splats < more_train.max_splats
        assert data.max_width < more_data.max_width
        assert train.sh_degree <= more_train.sh_degree
    assert math.isfinite(made[-1][1].means_lr)


def test_photos_grow_to_full_size() -> None:
    """Oracle: the definition: 75 pixels at first, halvings of the number of pixels, full at 0.9."""
    plan = plan_of(TrainConfig(iterations=1000), side=300)
    factors = [plan.factor_at(s) for s in range(1, 1001)]
    assert factors[0] == 4.0
    assert factors == sorted(factors, reverse=True)
    assert set(factors) == {2.0 ** (i / 2) for i in range(5)}
    assert factors[899:] == [1.0] * 101
    assert sum(f**-2 for f in factors) < 600, "the work of 600 full steps"
    assert plan_of(TrainConfig(), side=60).factor_at(1) == 1.0
    assert plan_of(TrainConfig(), side=10_000).coarse_factor == 8.0
    assert plan_of(TrainConfig(coarse_factor=1)).factor_at(1) == 1.0
    assert plan_of(TrainConfig(coarse_until=0)).factor_at(1) == 1.0
