"""MCMC strategy: relocation, slow growth to a cap, and noise (Kheradmand et al. 2024)."""

from collections.abc import Iterator

import torch

from ...config import TrainConfig
from ...engine.base import RowEdit
from ...engine.rotation import undirected
from ..schedule.plan import Plan
from . import relocation
from .base import Read, Within


class MCMCStrategy:
    """Grows the model on a fixed schedule, relocates dead splats and adds noise to faint ones."""

    counters = ()

    def __init__(self, config: TrainConfig, plan: Plan, *, extent: float, may_grow: Within) -> None:
        self._config = config
        self._plan = plan
        self._may_grow = may_grow
        self.opacity_reg = config.opacity_reg
        self.scale_reg = config.scale_reg

    def observes_at(self, step: int) -> bool:
        return False

    def noise_at(self, means_lr: float) -> float:
        return self._config.mcmc_noise * means_lr

    def refine(
        self, read: Read, *, step: int, cap: int, generator: torch.Generator
    ) -> Iterator[RowEdit]:
        if not self._plan.refines_at(step):
            return
        floor = max(self._config.prune_opacity, 1e-6)
        opacities = torch.from_numpy(read("opacities"))
        dead = ~(opacities > relocation.logit(floor))  # NaN is dead too
        dead |= undirected(torch.from_numpy(read("quats")))
        within = self._may_grow(read("means"))
        yield from relocation.relocate(
            read, dead.numpy(), generator, within=within, min_opacity=floor
        )
        count = len(opacities)
        target = min(cap, int((1 + self._plan.mcmc_growth) * count))
        within = self._may_grow(read("means"))
        yield from relocation.grow(
            read, target - count, generator, within=within, min_opacity=floor
        )
