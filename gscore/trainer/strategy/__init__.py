"""Densification strategies: how splats are added, moved and removed."""

from ...config import Strategy, TrainConfig
from ..schedule.plan import Plan
from .base import Change, Policy, Within, all_within, in_cell
from .default import DefaultStrategy
from .mcmc import MCMCStrategy


def make_strategy(
    config: TrainConfig, plan: Plan, *, extent: float, may_grow: Within = all_within
) -> Policy:
    """Create the strategy of `config`; splats are added only where `may_grow` is true."""
    kinds = {Strategy.DEFAULT: DefaultStrategy, Strategy.MCMC: MCMCStrategy}
    return kinds[config.strategy](config, plan, extent=extent, may_grow=may_grow)
