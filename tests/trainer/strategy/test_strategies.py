"""Decisions of strategies; oracle: hand-made models with an obvious right decision."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

from gscore.config import Doubling, Strategy, TrainConfig
from gscore.engine.base import RowEdit
from gscore.engine.cpu.model import CpuModel
from gscore.engine.cpu.splat_terms import add_noise, add_regularisers
from gscore.engine.rotation import rotate
from gscore.raster.random_numbers import normal_rows
from gscore.raster.screen_gradients import add_screen_gradients
from gscore.trainer.schedule.plan import Plan
from gscore.trainer.strategy import Change, Policy, make_strategy
from gscore.trainer.strategy.default import DefaultStrategy
from gscore.trainer.strategy.mcmc import MCMCStrategy
from gscore.trainer.strategy.relocation import logit

Make = Callable[..., CpuModel]
EXTENT = 1.0


def plan_of(config: TrainConfig) -> Plan:
    return Plan.of(config, extent=EXTENT, points=4, side=300, pixels=90_000)


def default(config: TrainConfig, model: CpuModel) -> DefaultStrategy:
    strategy = make_strategy(config, plan_of(config), extent=EXTENT)
    assert isinstance(strategy, DefaultStrategy)
    clear(model)
    return strategy


def clear(model: CpuModel) -> None:
    """Set the counters to zero."""
    count = len(model)
    model.edit(RowEdit(values={name: np.zeros(count, np.float32) for name in ("grad2d", "views")}))


def opaque(model: CpuModel, scale: float) -> CpuModel:
    """All splats opaque and round with standard deviation `scale`."""
    model.params["opacities"].data.fill_(2.0)
    model.params["scales"].data.fill_(math.log(scale))
    return model


def see(strategy: DefaultStrategy, model: CpuModel, gradients: list[float], step: int = 1) -> None:
    """Show one view, 200 x 100 px, with screen-space gradients in normalised coordinates, along
    x."""
    v = torch.zeros(len(model), 2)
    v[:, 0] = torch.tensor(gradients) / 100
    radii = torch.ones(len(model), dtype=torch.int32)
    if strategy.observes_at(step):
        add_screen_gradients(model.rows["grad2d"], model.rows["views"], v, radii, (100, 50))


def after(strategy: Policy, model: CpuModel, step: int, cap: int, *, seed: int = 0) -> Change:
    """The result of a step of the optimizer."""
    generator, change = torch.Generator().manual_seed(seed), Change()
    for edit in strategy.refine(model.column, step=step, cap=cap, generator=generator):
        change += Change.of(edit, len(model))
        model.edit(edit)
    return change


def refine(strategy: Policy, model: CpuModel, step: int, cap: int = 400_000) -> Change:
    return after(strategy, model, step, cap)


CONFIG = TrainConfig(
    iterations=1000, refine_start=10, refine_every=10, refine_stop=500, grow_grad=2e-4
)


def test_small_splats_are_cloned_large_ones_split(marked_model: Make) -> None:
    """Oracle: paper 5.2: a clone is a copy; a split replaces the splat by two smaller ones."""
    model = opaque(marked_model(4), 0.005)
    model.params["scales"].data[1] = math.log(0.05)
    strategy = default(replace(CONFIG, doubling=Doubling.CLONE_SPLIT), model)
    see(strategy, model, [3e-4, 3e-4, 1e-4, 0.0])
    change = refine(strategy, model, 10)
    assert change == Change(added=3, removed=1)
    marks = model.params["sh0"][:, 0, 0].tolist()
    assert marks == [0, 2, 3, 0, 1, 1]
    scales = model.params["scales"][:, 0]
    np.testing.assert_allclose(scales[-2:].numpy(), math.log(0.05 / 1.6), rtol=1e-6)
    torch.testing.assert_close(model.params["means"][3], torch.zeros(3))
    assert model.rows["grad2d"].tolist() == [0] * 6


def test_splats_with_large_gradients_are_split(marked_model: Make) -> None:
    """Oracle: all splats above the threshold, of any size, replaced by two rows each."""
    model = opaque(marked_model(4), 0.005)
    model.params["scales"].data[1] = math.log(0.05)
    strategy = default(CONFIG, model)
    see(strategy, model, [3e-4, 3e-4, 1e-4, 0.0])
    assert refine(strategy, model, 10) == Change(added=4, removed=2)
    assert model.params["sh0"][:, 0, 0].tolist() == [2, 3, 0, 1, 0, 1]
    assert model.rows["grad2d"].tolist() == [0] * 6


def test_a_refinement_puts_neighbours_together(marked_model: Make) -> None:
    """Oracle: the Morton order, along a line that of the coordinates; all of a row moves."""
    model = opaque(marked_model(6), 0.005)
    model.edit(RowEdit(keep=np.array([4, 0, 5, 2, 1, 3])))
    strategy = default(CONFIG, model)
    see(strategy, model, [0.0] * 6)
    assert not refine(strategy, model, 10)
    for p in (model.params["means"], model.params["sh0"], model.moments("sh0")[0] - 1000):
        assert p.reshape(6, -1)[:, 0].tolist() == [0, 1, 2, 3, 4, 5]


def test_no_change_between_refinements(marked_model: Make) -> None:
    """Oracle: no change in steps off the grid, before the start and after the stop."""
    model = opaque(marked_model(2), 0.005)
    strategy = default(CONFIG, model)
    see(strategy, model, [1.0, 1.0])
    for step in (5, 11, 510, 1000):
        assert not refine(strategy, model, step)
    assert len(model) == 2
    see(strategy, model, [1.0, 1.0], step=501)
    assert model.rows["views"].tolist() == [1, 1]


def test_the_cap_takes_the_largest_gradients(marked_model: Make) -> None:
    """Oracle: a sort by screen-space gradient."""
    config = TrainConfig(iterations=1000, refine_start=10, refine_every=10)
    model = opaque(marked_model(4), 0.005)
    strategy = default(config, model)
    see(strategy, model, [3e-4, 9e-4, 5e-4, 7e-4])
    refine(strategy, model, 10, cap=6)
    assert model.params["sh0"][:, 0, 0].tolist() == [0, 2, 1, 3, 1, 3]


def test_transparent_and_broken_splats_go(marked_model: Make) -> None:
    """Oracle: opacity below 0.005, NaN opacity and a zero quaternion, which are invisible."""
    model = opaque(marked_model(5), 0.005)
    model.params["opacities"].data[1] = logit(0.004)
    model.params["opacities"].data[2] = math.nan
    model.params["quats"].data[3] = 0
    strategy = default(CONFIG, model)
    assert refine(strategy, model, 10) == Change(removed=3)
    assert model.params["sh0"][:, 0, 0].tolist() == [0, 4]


def test_huge_splats_go_after_the_first_reset_only(marked_model: Make) -> None:
    """Oracle: larger than 0.1 extents."""
    config = TrainConfig(iterations=1000, refine_start=10, refine_every=10, reset_every=50)
    model = opaque(marked_model(3), 0.05)
    model.params["scales"].data[1, 2] = math.log(0.11)
    strategy = default(config, model)
    assert not refine(strategy, model, 40)
    change = refine(strategy, model, 50)
    assert change.reset
    assert change.removed == 0
    assert (torch.sigmoid(model.params["opacities"]) <= 0.0100001).all()
    assert refine(strategy, model, 60).removed == 1
    assert model.params["sh0"][:, 0, 0].tolist() == [0, 2]


def test_the_last_splats_are_never_removed(marked_model: Make) -> None:
    """Oracle: the unchanged model, because one without splats cannot learn."""
    model = opaque(marked_model(2), 0.005)
    model.params["opacities"].data.fill_(-20)
    strategy = default(CONFIG, model)
    assert not refine(strategy, model, 10)
    assert len(model) == 2


def mcmc(**options: float) -> tuple[MCMCStrategy, Plan]:
    config = TrainConfig(
        iterations=1000, refine_start=10, refine_every=10, strategy=Strategy.MCMC, **options
    )
    plan = plan_of(config)
    strategy = make_strategy(config, plan, extent=EXTENT)
    assert isinstance(strategy, MCMCStrategy)
    return strategy, plan


@pytest.mark.parametrize("kind", list(Strategy))
def test_splat_cap_is_respected(marked_model: Make, kind: Strategy) -> None:
    """Oracle: the caps, of splats that would all double; splats above them stay."""
    config = replace(CONFIG, strategy=kind, mcmc_growth=1)
    strategy = make_strategy(config, plan_of(config), extent=EXTENT)
    model = opaque(marked_model(4), 1e-4)
    for step, cap, expected in ((10, 4, 4), (20, 5, 5), (30, 8, 8), (40, 5, 8)):
        clear(model)
        if isinstance(strategy, DefaultStrategy):
            see(strategy, model, [1.0] * len(model), step=step)
        before = len(model)
        change = after(strategy, model, step, cap)
        assert change.removed in (0, change.added / 2), step  # halves take the place of one
        assert len(model) == before + change.added - change.removed == expected, step


@pytest.mark.parametrize("kind", list(Strategy))
def test_splats_are_added_only_where_they_may_be(marked_model: Make, kind: Strategy) -> None:
    """Oracle: a row of splats with equal gradients: on one side the number stays, and all rows
    added or moved have the marks of the other side."""
    config = replace(CONFIG, strategy=kind, mcmc_growth=1)

    def on_the_right(means: np.ndarray) -> np.ndarray:
        return means[:, 0] > 2.5

    strategy = make_strategy(config, plan_of(config), extent=EXTENT, may_grow=on_the_right)
    model = opaque(marked_model(6), 1e-4)
    clear(model)
    if isinstance(strategy, DefaultStrategy):
        see(strategy, model, [1.0] * 6)
    else:
        model.params["opacities"].data[5] = -20.0  # dead: it moves onto a live one
    after(strategy, model, 10, 9)
    marks = model.params["sh0"][:, 0, 0].tolist()
    assert len(marks) == 9 and sorted(marks)[:3] == [0, 1, 2]
    assert all(mark > 2 for mark in sorted(marks)[3:])


def test_dead_splats_without_a_target_are_not_relocated(marked_model: Make) -> None:
    """Oracle: the number of splats, for dead ones without a target."""
    strategy, _ = mcmc(mcmc_growth=1)
    strategy._may_grow = lambda means: np.zeros(len(means), bool)
    model = opaque(marked_model(4), 1e-4)
    model.params["opacities"].data[0] = -20.0
    assert after(strategy, model, 10, 9) == Change()
    assert len(model) == 4


def test_mcmc_grows_to_the_cap_and_no_further(marked_model: Make) -> None:
    """Oracle: floor(1.5 N) at each refinement, then exactly the cap."""
    strategy, _ = mcmc(mcmc_growth=0.5)
    model = marked_model(8)
    sizes = []
    for step in (10, 20, 30, 40):
        after(strategy, model, step, 20, seed=step)
        sizes.append(len(model))
    assert sizes == [12, 18, 20, 20]


def test_mcmc_counts_broken_splats_as_dead(marked_model: Make) -> None:
    """Oracle: finite rows with a direction after a refinement."""
    strategy, _ = mcmc()
    model = opaque(marked_model(4), 0.01)
    model.params["opacities"].data[0] = math.nan
    model.params["quats"].data[1] = 0
    change = after(strategy, model, 10, 4)
    assert change == Change(moved=2)
    for name, p in model.params.items():
        assert torch.isfinite(p).all(), name
    assert (model.params["quats"].norm(dim=1) > 0.1).all()


def test_mcmc_gradients_are_those_of_its_penalties(marked_model: Make) -> None:
    """Oracle: torch autograd of 0.01 mean(opacity) + 0.08 mean(scale)."""
    strategy, _ = mcmc(opacity_reg=0.01, scale_reg=0.08)
    model = marked_model(5)
    opacities = model.params["opacities"].clone().requires_grad_()
    scales = model.params["scales"].clone().requires_grad_()
    (0.01 * torch.sigmoid(opacities).mean() + 0.08 * scales.exp().mean()).backward()
    add_regularisers(model, opacity_reg=strategy.opacity_reg, scale_reg=strategy.scale_reg)
    torch.testing.assert_close(model.grads["opacities"], opacities.grad)
    torch.testing.assert_close(model.grads["scales"], scales.grad)


def test_mcmc_noise_moves_faint_splats_along_their_shape(marked_model: Make) -> None:
    """Oracle: covariance of the shifts = gate^2 weight^2 Sigma^2; opaque splats stay."""
    strategy, _ = mcmc(mcmc_noise=10.0)
    n = 20_000
    model = marked_model(n)
    model.params["means"].data.zero_()
    model.params["quats"].data[:] = torch.tensor([0.9, 0.3, -0.2, 0.4])
    model.params["scales"].data[:] = torch.tensor([0.5, 0.2, 0.1]).log()
    model.params["opacities"].data[:] = logit(0.01)
    model.params["opacities"].data[: n // 2] = 2.0
    add_noise(model, strategy.noise_at(0.1), partial(normal_rows, seed=0, step=1, stream=1))
    means = model.params["means"].double().numpy()
    assert not means[: n // 2].any()
    gate = 1 / (1 + math.exp(100 * (0.01 - 0.005)))
    axes = rotate(model.params["quats"][:3], torch.eye(3)).double().numpy().T
    sigma = axes @ np.diag([0.25, 0.04, 0.01]) @ axes.T
    expected = (gate * 10.0 * 0.1) ** 2 * sigma @ sigma
    found = np.cov(means[n // 2 :].T)
    np.testing.assert_allclose(found, expected, atol=0.03 * expected.max())


@pytest.mark.parametrize("strategy", list(Strategy))
def test_both_strategies_take_a_model_of_one(marked_model: Make, strategy: Strategy) -> None:
    """Oracle: no error."""
    config = TrainConfig(iterations=100, refine_start=1, refine_every=1, strategy=strategy)
    model = opaque(marked_model(1), 0.01)
    policy = make_strategy(config, plan_of(config), extent=EXTENT)
    clear(model)
    after(policy, model, 5, len(model))
    add_noise(model, policy.noise_at(1e-4), partial(normal_rows, seed=0, step=1, stream=1))
    assert len(model) >= 1
