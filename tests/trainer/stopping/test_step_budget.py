"""Runs with a budget of seconds; oracle: machines with made-up step times."""

from collections.abc import Callable
from dataclasses import replace

import pytest

from gscore.config import TrainConfig
from gscore.trainer.estimate.cost import Cost
from gscore.trainer.schedule.plan import Plan
from gscore.trainer.stopping.controller import StepBudget

CONFIG = TrainConfig(max_splats=50_000)


def plan_of(iterations: int, points: int = 7000) -> Plan:
    config = replace(CONFIG, iterations=iterations)
    return Plan.of(config, extent=1.0, points=points, side=300, pixels=120_000)


def simulate(
    budget: float, seconds: Callable[[Plan, int, int], float], *, growth: float
) -> tuple[Plan, int, float]:
    """A run on a simulated machine: its last plan, its steps and its seconds."""
    pace, plan, step, splats, elapsed = StepBudget(budget, plan_of), plan_of(7000), 0, 7000, 0.0
    recent: list[tuple[float, float]] = []
    while step < plan.iterations:
        spent = seconds(plan, step + 1, splats)
        recent = [*recent[-49:], (spent, Cost(plan).seconds_at(step + 1, splats))]
        step, elapsed = step + 1, elapsed + spent
        if plan.refines_at(step):
            splats = min(int(splats * (1 + growth)), CONFIG.max_splats)
        if pace.due(step, elapsed):
            rate = sum(a for a, _ in recent) / sum(b for _, b in recent)
            length = pace.length(step, splats=splats, elapsed=elapsed, pace=rate)
            plan = plan_of(length)
    return plan, step, elapsed


def steady(factor: float) -> Callable[[Plan, int, int], float]:
    return lambda plan, step, splats: factor * Cost(plan).seconds_at(step, splats)


def slowing(plan: Plan, step: int, splats: int) -> float:
    """Half the speed after step 300, as when another program starts."""
    return Cost(plan).seconds_at(step, splats) * (1 if step < 300 else 2)


def pixels_only(plan: Plan, step: int, splats: int) -> float:
    """A machine on which splats cost no time, unlike in the plan."""
    return 2e-7 * plan.pixels / plan.factor_at(step) ** 2


@pytest.mark.parametrize("growth", [0.1, 0.5, 1.0])
@pytest.mark.parametrize(
    "seconds",
    [steady(0.3), steady(1.0), steady(4.0), slowing, pixels_only],
    ids=["quick", "as predicted", "slow", "slowing", "pixels only"],
)
def test_budget_is_met(seconds: Callable[[Plan, int, int], float], growth: float) -> None:
    """Oracle: the sum of the times of all steps; the end of all schedules."""
    plan, step, elapsed = simulate(10.0, seconds, growth=growth)
    assert elapsed == pytest.approx(10.0, rel=0.05)
    assert plan.iterations == step
    assert plan.factor_at(step) == 1
    assert plan.means_lr_at(step) == pytest.approx(plan.means_lr[1])


def test_exhausted_budget_ends_now() -> None:
    """Oracle: the definition."""
    pace = StepBudget(10.0, plan_of)
    assert pace.due(400, 10.5)
    assert pace.length(400, splats=7000, elapsed=10.5, pace=1.0) == 400
