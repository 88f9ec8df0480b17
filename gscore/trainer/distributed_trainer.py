"""Distributed trainer: a trainer on each of several ranks, with one photo per rank and step."""

from collections.abc import Iterable
from typing import Any

import torch

from ..config import TrainConfig
from ..errors import GsError
from .analysis.analysis import Analysis
from .distributed.batch_losses import OtherRankError
from .distributed.data_parallel import DataParallelEngine
from .distributed.process_group import COLLECT, RESTORE, STEP, ProcessGroup, RankLostError
from .model.ensemble_member import EnsembleMember
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
        length, factor = self.plan.iterations, self.rate_factor
        self.group.broadcast({"do": STEP, "iterations": length, "rate_factor": factor})
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
            self.group.broadcast({"do": COLLECT})
            self._collect_now()

    def _collect_now(self) -> None:
        """Like `collect`, without a broadcast, because all ranks end with the same error."""
        self._engine.collect(self.models.models)

    def _send_restored(self, state: dict[str, Any], tensors: dict[str, torch.Tensor]) -> None:
        if self.group.is_rank0:
            self.group.broadcast({"do": RESTORE, "state": state})
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


def batch_size(
    size: int, taken: int, *, every: Iterable[int], marks: Iterable[int], end: int
) -> int:
    """Return the number of photos of the next step: `size`, or less up to the next event.

    Events so occur after the same number of photos for any number of processes.

    Args:
        size: Size of a full batch, at least 1.
        taken: Photos before this step.
        every: Periods of recurring events, in photos; those below 1 are ignored.
        marks: Numbers of photos after which single events occur.
        end: Number of photos of the run.
    """
    left = [number - taken % number for number in every if number >= 1]
    left += [mark - taken for mark in (*marks, end) if mark > taken]
    return min([size, *left])
