"""Strategies: how the number of splats changes during training."""

from ...config import Strategy as StrategyName
from ...config import TrainConfig
from ..schedule.plan import Plan
from .base import Change, Strategy
from .default import DefaultStrategy
from .mcmc import MCMCStrategy

__all__ = ["Change", "Strategy", "make_strategy"]


def make_strategy(config: TrainConfig, plan: Plan, *, extent: float) -> Strategy:
    """The strategy that `config` names."""
    kinds = {StrategyName.DEFAULT: DefaultStrategy, StrategyName.MCMC: MCMCStrategy}
    return kinds[config.strategy](config, plan, extent=extent)
