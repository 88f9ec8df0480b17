"""Strategies: how the number of splats changes during training."""

from ...config import Strategy, TrainConfig
from ..schedule.plan import Plan
from .base import Change, DrawnView, Policy
from .default import DefaultStrategy
from .mcmc import MCMCStrategy

__all__ = ["Change", "DrawnView", "Policy", "make_strategy"]


def make_strategy(config: TrainConfig, plan: Plan, *, extent: float) -> Policy:
    """The strategy that `config` names."""
    kinds = {Strategy.DEFAULT: DefaultStrategy, Strategy.MCMC: MCMCStrategy}
    return kinds[config.strategy](config, plan, extent=extent)
