"""Block runs: trainings of the blocks of a split capture, one block or all of them in turn."""

import argparse
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import ConfigError, DatasetError, GsError
from ..io.block_record import block_name, block_records
from ..io.runs import checkpoints_in, results_in
from ..quoting import brief
from ..text_format import count_words
from .terminal.torchrun_launch import under_torchrun
from .torchrun import agent, train_distributed, train_in_turn

if TYPE_CHECKING:
    from ..trainer.distributed.process_group import ProcessGroup

Lead = Callable[[argparse.Namespace, "ProcessGroup | None"], int]
"""Trains one capture, as rank 0 of a team or alone; returns the exit code."""


def source_of(args: argparse.Namespace) -> Path | None:
    """The capture given to `gscore train`."""
    return args.source or args.source_option


def wants_blocks(args: argparse.Namespace) -> bool:
    """Whether `gscore train` was given a folder of blocks instead of a capture."""
    source = source_of(args)
    return args.block is not None or (source is not None and bool(block_records(source)))


def train_blocks(args: argparse.Namespace, lead: Lead) -> int:
    """Train the named block, on all ranks together; without a name all blocks in turn, each on one
    rank. Returns the exit code.

    Raises:
        ConfigError: there is no such block, or its run exists already.
        DatasetError: there are no blocks.
    """
    if args.block is None:
        if under_torchrun():
            return train_in_turn(args, lambda args, team: _all(args, lead, team))
        return _all(args, lead, None)
    one = _one(args, _found(args, [args.block])[0], resume=args.resume)
    return train_distributed(one, lead) if under_torchrun() else lead(one, None)


def _all(args: argparse.Namespace, lead: Lead, team: "ProcessGroup | None") -> int:
    codes: list[int] = []

    def through(blocks: Iterable[int], *, resume: bool) -> str:
        for index in blocks:
            try:
                codes.append(lead(_one(args, index, resume=resume), None))
            except GsError as error:
                raise type(error)(f"{block_name(index)}: {error}") from error
            if codes[-1]:
                return "stopped"
        return "finished"

    if team is None:
        blocks = _found(args)
        _check_room(args, blocks, resume=args.resume)
        through(blocks, resume=args.resume)
        return max(codes, default=0)
    _all_in_turn(args, team, through)
    return max(codes, default=0)


def _all_in_turn(
    args: argparse.Namespace, team: "ProcessGroup", through: Callable[..., str]
) -> None:
    from ..trainer.distributed.consistency import check_ready
    from ..trainer.distributed.work_queue import WorkQueue

    shared = WorkQueue(team=team, output=args.output, agent=agent())
    resume, blocks, failure = args.resume, [], None
    try:
        blocks = _found(args)
        if team.is_rank0:
            resume = resume or shared.has_started
            _check_room(args, blocks, resume=resume)
    except GsError as error:
        failure = error
    check_ready(team, failure)
    shared.work(
        len(blocks),
        lambda turns, resume: through((blocks[turn] for turn in turns), resume=resume),
        resume=resume,
    )


def _found(args: argparse.Namespace, wanted: Sequence[int] | None = None) -> list[int]:
    """Indices of the blocks to train, checked to exist; all if none is named."""
    source = source_of(args)
    if source is None:
        raise ConfigError("No blocks were given: `gscore train BLOCKS --block 0 -o RUNS`.")
    records = block_records(source)
    if not records:
        raise DatasetError(
            f"{brief(source)} contains no blocks; give the output folder of gscore split."
        )
    count = next(iter(records.values())).count
    wanted = range(count) if wanted is None else wanted
    for index in wanted:
        if not 0 <= index < count:
            raise ConfigError(
                f"There is no block {index} in {brief(source)}: its {count_words(count, 'block')} "
                f"have the numbers 0 to {count - 1}."
            )
        if index not in records:
            raise DatasetError(
                f"Block {index} of {count} is not in {brief(source)}. Copy {block_name(index)} "
                "there, or train the existing ones individually with `--block`."
            )
    return list(wanted)


def _check_room(args: argparse.Namespace, blocks: Sequence[int], *, resume: bool) -> None:
    begun = [name for name in map(block_name, blocks) if results_in(args.output / name)]
    if begun and not (resume or args.overwrite):
        raise ConfigError(
            f"{brief(args.output)} contains runs on {count_words(len(begun), 'block')}, the first "
            f"in {begun[0]}; continue with `--resume`, which keeps completed ones, replace them "
            "with `--overwrite`, or choose another folder."
        )


def _one(args: argparse.Namespace, index: int, *, resume: bool) -> argparse.Namespace:
    """Arguments of `gscore train` for one block, in a folder of the block's name."""
    source, output = source_of(args), args.output / block_name(index)
    assert source is not None
    goes_on = resume and bool(checkpoints_in(output))
    changed = {
        "source": source / block_name(index),
        "source_option": None,
        "output": output,
        "block": None,
        "resume": goes_on,
        # A run that was killed before its first checkpoint cannot be continued.
        "overwrite": (args.overwrite or resume) and not goes_on,
    }
    return argparse.Namespace(**vars(args) | changed)
