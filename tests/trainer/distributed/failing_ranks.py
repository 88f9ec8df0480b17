"""Run by two ranks: one photo is missing; both end with the data that a checkpoint needs."""

import sys
from typing import NoReturn

import torch

from gscore.config import TrainConfig
from gscore.errors import DatasetError
from gscore.stress.capture import toy_photos
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.distributed.process_group import ProcessGroup
from gscore.trainer.distributed_trainer import DistributedTrainer

CONFIG = TrainConfig(iterations=60, max_splats=300, sh_degree=1, sh_every=1, shN_every=9, threads=1)


def gone(*_: object, **__: object) -> NoReturn:
    """Replacement for the reader of a photo."""
    raise DatasetError("the photo is gone")


def main() -> int:
    """0: both raise, and rank 0 has the gradients accumulated on rank 1, from before or not."""
    torch.set_num_threads(1)
    with ProcessGroup() as group:
        trainer = DistributedTrainer(CONFIG, Analysis(photos=toy_photos()), group=group)
        for act in (trainer.step, trainer.step, trainer.collect)[: 2 + ("before" in sys.argv)]:
            if not group.is_rank0:
                group.receive()
            act()
        gathered = trainer.model.grads["shN"].clone()
        if group.rank == 1:
            trainer.renderer.sized = gone
        if not group.is_rank0:
            group.receive()
        try:
            trainer.step()
        except DatasetError as error:
            assert "the photo is gone" in str(error)
        else:
            raise AssertionError("no error")
        if group.is_rank0:
            found = trainer.tensors()
            assert torch.equal(found["gathered/shN"], gathered)
            assert found["gathered/shN/1"].any()
            assert not torch.equal(found["gathered/shN/1"], gathered)
    return 0


if __name__ == "__main__":
    sys.exit(main())
