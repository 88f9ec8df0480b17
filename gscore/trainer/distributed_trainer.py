"""Distributed trainer: a trainer on each of several ranks, with one photo per rank and step."""

from typing import Any

import torch

from ..config import TrainConfig
from ..errors import GsError
from .analysis.analysis import Analysis
from .distributed import rank_commands
from .distributed.batch_losses import OtherRankError
from .distributed.data_parallel import DataParallelEngine
from .distributed.process_group import ProcessGroup, RankLostError
from .model.ensemble_member import EnsembleMember
from .schedule.batch_size import batch_size
from .step.step_edits import SANITIZE_EVERY
from .step.step_queue import RequestedStep
from .step.step_result import StepResult
from .step.training_views import TrainingView
from .trainer import Trainer


class DistributedTrainer(Trainer):
    """Trainer of one rank. R ranks render R different views in one step, and `steps` rises by R.

    Rank 0 broadcasts each step, collection and restore; the workers then call the same method.
    """

    group: ProcessGroup

    def __init__(self, config: TrainConfig, analysis: Analysis, group: ProcessGroup) -> None:
        """Start as `Trainer`; each rank has a trainer."""
        self.group = group
        self._engine = DataParallelEngine(group, threads=config.threads)
        super().__init__(config, analysis, self._engine)

    def advance(self) -> list[StepResult]:
        """Take a step with all ranks; errors are those of `Trainer.advance`, and RankLostError if
        another process is gone."""
        self.group.broadcast(rank_commands.take_step(self.plan.iterations, self.rate_factor))
        with self.group.stepping():
            return self._advance(self._photos_at_once())

    def _draw_views(self, step: int, count: int) -> list[TrainingView]:
        try:
            return super()._draw_views(step, count)
        except RankLostError:
            raise
        except GsError:
            self._collect_now()
            raise

    def _requested(
        self, member: EnsembleMember, training_view: TrainingView, step: int
    ) -> RequestedStep:
        try:
            return super()._requested(member, training_view, step)
        except OtherRankError:
            self.view_batcher.put_back(len(training_view.indices))
            self._collect_now()
            raise

    def collect(self) -> None:
        """Collect on rank 0 the state that only other ranks have; called on rank 0."""
        if not self._engine.collected(self.models.models):
            self.group.broadcast(rank_commands.collect())
            self._collect_now()

    def _collect_now(self) -> None:
        """Like `collect`, without a broadcast, because all ranks end with the same error."""
        self._engine.collect(self.models.models)

    def _send_restored(self, state: dict[str, Any], tensors: dict[str, torch.Tensor]) -> None:
        if self.group.is_rank0:
            self.group.broadcast(rank_commands.restore(state))
            self.group.share(tensors)

    def _photos_at_once(self) -> int:
        plan, config = self.plan, self.config
        return batch_size(
            self.group.size,
            self.steps,
            every=(
                *(plan.refine_every, plan.reset_every, plan.kept_every),
                *(config.snapshot_every, SANITIZE_EVERY),
            ),
            marks=(
                *config.save_iterations,
                *config.test_iterations,
                *config.checkpoint_iterations,
            ),
            end=plan.iterations,
        )
