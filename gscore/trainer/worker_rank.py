"""Worker ranks: all but rank 0 run rank 0's commands, and write and report nothing."""

from pathlib import Path
from typing import Any

from ..config import DataConfig, TrainConfig
from ..config_file import from_dict
from ..control import Control
from ..formats import read_decoded
from .distributed import rank_commands
from .distributed.consistency import check_equal, check_ready
from .distributed.process_group import ProcessGroup
from .host.isolated_state import isolated_torch_state
from .host.malloc import mmap_large_blocks
from .model.training_frame import TrainingFrame, checkpoint_origin
from .prepare import Prepared, prepare, readable_memory_errors
from .trainer import Trainer

_WHERE = "options of rank 0"


def run_worker(team: ProcessGroup, source: Path | None) -> bool:
    """Run the commands of rank 0 until it ends the training.

    Args:
        team: Process group of the training.
        source: Path of the capture on this machine; None: the path on rank 0.

    Returns:
        Whether the training completed.

    Raises:
        GsError: this rank failed; the others have been notified unless `team.notified` is False.
    """
    mmap_large_blocks()
    order = team.receive()
    if order["do"] == rank_commands.END:
        return not order["failed"]
    with isolated_torch_state(), readable_memory_errors():
        found, failure = None, None
        try:
            found = _prepared(order, team, source)
        except Exception as error:
            failure = error
        check_ready(team, failure)
        assert found is not None
        check_equal(team, found.facts())
        return _run_commands(team, found.trainer)


def _prepared(order: dict[str, Any], team: ProcessGroup, source: Path | None) -> Prepared:
    data = from_dict(DataConfig, order["data"], where=_WHERE)
    if source is not None:
        data = from_dict(DataConfig, order["data"] | {"source": str(source)}, where=_WHERE)
    config, facts = from_dict(TrainConfig, order["config"], where=_WHERE), order["facts"]
    frame = None if facts["frame"] is None else TrainingFrame.from_dict(facts["frame"])
    return prepare(
        config,
        data,
        taken=facts["taken"],
        stereo=facts["stereo"],
        frame=lambda photos: frame,
        start=None if config.start_splats is None else read_decoded(config.start_splats),
        origin=None if facts["frame"] is None else checkpoint_origin(facts["frame"]),
        emit=lambda event: None,
        control=Control(),
        team=team,
    )


def _run_commands(team: ProcessGroup, trainer: Trainer) -> bool:
    """Run commands until rank 0 sends the end; returns whether the training completed."""
    while True:
        order = team.receive()
        if order["do"] == rank_commands.END:
            return not order["failed"]
        if order["do"] == rank_commands.COLLECT:
            trainer.collect()
            continue
        if order["do"] == rank_commands.RESTORE:
            trainer.release()
            trainer.restore(order["state"], team.share(None))
            continue
        if trainer.plan.iterations != order["iterations"]:
            trainer.replan(order["iterations"])
        trainer.rate_factor = order["rate_factor"]
        trainer.step()
