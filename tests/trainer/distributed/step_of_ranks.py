"""Run by two ranks: one step together, and the same two photos one by one on rank 0."""

import sys
from typing import Any

import torch

from gscore.config import TrainConfig
from gscore.stress.capture import toy_photos
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.distributed.process_group import ProcessGroup
from gscore.trainer.distributed_trainer import DistributedTrainer
from gscore.trainer.trainer import Trainer

CONFIG = TrainConfig(iterations=60, max_splats=300, sh_degree=1, sh_every=1, shN_every=2, threads=1)


def trained_on(trainer: Trainer) -> dict[str, torch.Tensor]:
    """The gradients and counts that a step learns from."""
    found: dict[str, torch.Tensor] = {}
    step = trainer.model.step

    def keep(*arguments: Any, **options: Any) -> int:
        found.update({name: grad.clone() for name, grad in trainer.model.grads.items()})
        found.update({name: trainer.model.rows[name].clone() for name in ("grad2d", "views")})
        return step(*arguments, **options)

    trainer.model.step = keep
    trainer.step()
    return found


def alone(index: int) -> dict[str, torch.Tensor]:
    """Like `learnt_from`, of one photo, at the step that both ranks take together."""
    trainer = Trainer(CONFIG, Analysis(photos=toy_photos()))
    trainer.counts.steps = 1
    trainer.models.widen_sh(1)
    trainer.sampler.order, trainer.sampler.position = [index], 0
    return trained_on(trainer)


def main() -> int:
    """0: the mean of the gradients of each photo, and the sum of the counts and of the gradients of
    shN, accumulated over many photos, to the bit."""
    torch.set_num_threads(1)
    with ProcessGroup() as group:
        trainer = DistributedTrainer(CONFIG, Analysis(photos=toy_photos()), group=group)
        trainer.models.widen_sh(1)
        if not group.is_rank0:
            group.receive()
        together = trained_on(trainer)
        assert trainer.steps == 2
        first, second = (alone(index) for index in trainer.sampler.order[:2])
        for name, found in together.items():
            added = first[name] + second[name]
            expected = added if name in ("grad2d", "views", "shN") else added / 2
            assert torch.equal(found, expected), name
            assert (found != first[name]).any(), name
    return 0


if __name__ == "__main__":
    sys.exit(main())
