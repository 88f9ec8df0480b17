"""Block runs: trainings of the blocks of a split capture, one block or all of them in turn."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from ..errors import ConfigError, DatasetError, GsError
from ..io.block_record import block_name, block_records
from ..io.runs import checkpoints_in, results_in
from ..quoting import brief
from ..text_format import count_text
from .args.train_request import TrainRequest
from .torchrun import agent, train_distributed, train_in_turn

if TYPE_CHECKING:
    from ..trainer.distributed.process_group import ProcessGroup

Lead = Callable[[TrainRequest, "ProcessGroup | None"], int]
"""Trains one capture, as rank 0 of a process group or alone; returns the exit code."""


def wants_blocks(request: TrainRequest) -> bool:
    """Whether `gscore train` was given a folder of blocks instead of a capture."""
    source = request.source
    return request.block is not None or (source is not None and bool(block_records(source)))


def train_blocks(request: TrainRequest, lead: Lead) -> int:
    """Train the named block, on all ranks together; without a name all blocks in turn, each on one
    rank. Returns the exit code.

    Raises:
        ConfigError: there is no such block, or its run exists already.
        DatasetError: there are no blocks.
    """
    if request.block is None:
        return train_in_turn(request, lambda request, group: _all(request, lead, group))
    one = _one(request, _found(request, [request.block])[0], resume=request.resume)
    return train_distributed(one, lead)


def _all(request: TrainRequest, lead: Lead, group: "ProcessGroup | None") -> int:
    codes: list[int] = []

    def through(blocks: Iterable[int], *, resume: bool) -> str:
        for index in blocks:
            try:
                codes.append(lead(_one(request, index, resume=resume), None))
            except GsError as error:
                raise type(error)(f"{block_name(index)}: {error}") from error
            if codes[-1]:
                return "stopped"
        return "finished"

    if group is None:
        blocks = _found(request)
        _check_room(request, blocks, resume=request.resume)
        through(blocks, resume=request.resume)
        return max(codes, default=0)
    _all_in_turn(request, group, through)
    return max(codes, default=0)


def _all_in_turn(request: TrainRequest, group: "ProcessGroup", through: Callable[..., str]) -> None:
    from ..trainer.distributed.consistency import all_ready
    from ..trainer.distributed.work_queue import WorkQueue

    shared = WorkQueue(group=group, output=request.output, agent=agent())
    resume = request.resume
    with all_ready(group):
        blocks = _found(request)
        if group.is_rank0:
            resume = resume or shared.has_started
            _check_room(request, blocks, resume=resume)
    shared.work(
        len(blocks),
        lambda turns, resume: through((blocks[turn] for turn in turns), resume=resume),
        resume=resume,
    )


def _found(request: TrainRequest, chosen: Sequence[int] | None = None) -> list[int]:
    """Indices of the blocks to train, checked to exist; all if none is named."""
    source = request.source
    if source is None:
        raise ConfigError("No blocks were given: `gscore train BLOCKS --block 0 -o RUNS`.")
    records = block_records(source)
    if not records:
        raise DatasetError(
            f"{brief(source)} contains no blocks; give the output folder of gscore split."
        )
    count = next(iter(records.values())).count
    chosen = range(count) if chosen is None else chosen
    for index in chosen:
        if not 0 <= index < count:
            raise ConfigError(
                f"There is no block {index} in {brief(source)}: its {count_text(count, 'block')} "
                f"have the numbers 0 to {count - 1}."
            )
        if index not in records:
            raise DatasetError(
                f"Block {index} of {count} is not in {brief(source)}. Copy {block_name(index)} "
                "there, or train the existing ones individually with `--block`."
            )
    return list(chosen)


def _check_room(request: TrainRequest, blocks: Sequence[int], *, resume: bool) -> None:
    output = request.output
    begun = [name for name in map(block_name, blocks) if results_in(output / name)]
    if begun and not (resume or request.overwrite):
        raise ConfigError(
            f"{brief(output)} contains runs on {count_text(len(begun), 'block')}, the first "
            f"in {begun[0]}; continue with `--resume`, which keeps completed ones, replace them "
            "with `--overwrite`, or choose another folder."
        )


def _one(request: TrainRequest, index: int, *, resume: bool) -> TrainRequest:
    """The request for one block, into a folder of the block's name."""
    output = request.output / block_name(index)
    assert request.source is not None
    goes_on = resume and bool(checkpoints_in(output))
    return replace(
        request,
        source=request.source / block_name(index),
        output=output,
        block=None,
        resume=goes_on,
        # A run that was killed before its first checkpoint cannot be continued.
        overwrite=(request.overwrite or resume) and not goes_on,
    )
