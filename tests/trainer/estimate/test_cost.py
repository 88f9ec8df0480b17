"""Predicted time of the steps of a plan; oracles: sums over steps, a walk from step to step."""

from dataclasses import replace
from typing import Any

import pytest

from gscore.config import Strategy, TrainConfig
from gscore.trainer.estimate.cost import Cost
from tests.trainer.schedule.test_plan import plan_of


def test_seconds_after_is_the_sum_of_steps() -> None:
    """Oracle: the sum over all steps, at a constant count."""
    plan = plan_of(TrainConfig(iterations=1000, max_splats=50_000), points=50_000)
    for step in (0, 1, 500, 990, 999, 1000):
        whole = sum(Cost(plan).seconds_at(s, 50_000) for s in range(step + 1, 1001))
        found = Cost(plan).seconds_after(step, 50_000)
        assert found == pytest.approx(whole, rel=0.02), step


def test_splats_to_expect_wait_for_the_photos() -> None:
    """Oracle: fast growth limited by the caps of the sizes; slow growth unaffected by them."""
    config = TrainConfig(iterations=3000, max_splats=60_000)
    plan = plan_of(config, points=5000)
    for step in (500, 1000, 1500, 2000, 2400, 2900):
        last = min(step - 1, plan.refine_stop) // plan.refine_every * plan.refine_every
        expected = plan.cap_for(plan.factor_at(last))
        assert Cost(plan).splats_at(step, 0, 5000) == pytest.approx(expected), step
    slow = replace(config, grow_grad=1e-2)
    at_once = plan_of(replace(slow, grow_with_photos=False, refine_stop=plan.refine_stop))
    assert (
        Cost(plan_of(slow)).splats_at(2900, 0, 5000)
        == Cost(at_once).splats_at(2900, 0, 5000)
        < 10_000
    )


@pytest.mark.parametrize(
    "options",
    [{}, {"strategy": Strategy.MCMC}, {"grow_grad": 4e-4}, {"prune_share": 0.3}],
    ids=str,
)
def test_splats_to_expect_are_those_of_each_refinement(options: dict[str, Any]) -> None:
    """Oracle: a walk from step to step: the k-th refinement adds at most half of the splats and
    2.2e-4 / grow_grad k^-1.15 of them; `mcmc` a constant share; then some are pruned."""
    config = TrainConfig(iterations=3000, max_splats=60_000, grow_with_photos=False, **options)
    plan = plan_of(config)
    refinements = [s for s in range(1, 3001) if plan.refines_at(s)]
    assert len(refinements) > 10
    for start in (0, refinements[0] - 1, refinements[0], refinements[4], refinements[-1]):
        splats = 5000.0
        for step in range(start + 1, 3001):
            kept = plan.kept if start < plan.refine_stop < step else 1.0
            assert Cost(plan).splats_at(step, start, 5000) == pytest.approx(kept * splats), step
            if step in refinements:
                k = refinements.index(step) + 1
                growth = plan.mcmc_growth or min(0.5, 2.2e-4 / plan.grow_grad * k**-1.15)
                splats = min(splats * (1 + growth), 60_000)


def test_steps_with_the_surface_term_take_longer() -> None:
    """Oracle: the same step without the term; its share of the run."""
    config = TrainConfig(iterations=1000, surface_weight=1.0, surface_from=0.6)
    plain, cost = Cost(plan_of(replace(config, surface_weight=0.0))), Cost(plan_of(config))
    for step in (1, 600):
        assert cost.seconds_at(step, 9000) == plain.seconds_at(step, 9000)
    for step in (601, 1000):
        assert cost.seconds_at(step, 9000) > 2 * plain.seconds_at(step, 9000)
