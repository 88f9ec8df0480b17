"""Worker ranks: all but rank 0 run rank 0's commands, and write and report nothing."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from ..config import DataConfig, TrainConfig
from ..config_file import from_dict
from ..control import Control
from ..formats import read_decoded
from .distributed.consistency import all_ready, check_equal
from .distributed.process_group import COLLECT, END, RESTORE, ProcessGroup
from .host.isolated_state import isolated_torch_state, mmap_large_blocks
from .prepare import Prepared, StartState, prepare, readable_memory_errors
from .trainer import Trainer

_WHERE = "options of rank 0"


def run_worker(group: ProcessGroup, source: Path | None) -> bool:
    """Run the commands of rank 0 until it ends the training.

    Args:
        group: Process group of the training.
        source: Path of the capture on this machine; None: the path on rank 0.

    Returns:
        Whether the training completed.

    Raises:
        GsError: this rank failed; the others have been notified unless `group.notified` is False.
    """
    mmap_large_blocks()
    order = group.receive()
    if order["do"] == END:
        return not order["failed"]
    with isolated_torch_state(), readable_memory_errors():
        with all_ready(group):
            found = _prepared(order, group, source)
        check_equal(group, found.facts())
        return _run_commands(group, found.trainer)


def _prepared(order: dict[str, Any], group: ProcessGroup, source: Path | None) -> Prepared:
    data = from_dict(DataConfig, order["data"], where=_WHERE)
    config = from_dict(TrainConfig, order["config"], where=_WHERE)
    splats = None if config.start_splats is None else read_decoded(config.start_splats)
    return prepare(
        config,
        data if source is None else replace(data, source=source),
        StartState(**order["facts"], splats=splats),
        emit=lambda event: None,
        control=Control(),
        group=group,
    )


def _run_commands(group: ProcessGroup, trainer: Trainer) -> bool:
    """Run commands until rank 0 sends the end; returns whether the training completed."""
    while True:
        order = group.receive()
        if order["do"] == END:
            return not order["failed"]
        if order["do"] == COLLECT:
            trainer.collect()
            continue
        if order["do"] == RESTORE:
            trainer.release()
            trainer.restore(order["state"], group.share(None))
            continue
        if trainer.plan.iterations != order["iterations"]:
            trainer.replan(order["iterations"])
        trainer.rate_factor = order["rate_factor"]
        trainer.step()
