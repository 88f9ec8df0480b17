"""Training under torchrun: rank 0 runs the command, the others work for it."""

import argparse
import os
import platform
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ..errors import DatasetError, GsError
from ..io.runs import AGENT, checkpoints_in
from ..metrics.machine import cores
from .terminal.interrupt import interrupts
from .terminal.torchrun_launch import under_torchrun

if TYPE_CHECKING:
    from ..trainer.distributed.process_group import ProcessGroup

_OWN = {
    *("source", "source_option", "output", "threads", "resume", "overwrite", "start_checkpoint"),
    *("quiet", "events", "json", "config", "masks"),
}
"""Options that may differ by rank, or that only rank 0 reads."""


def train_distributed(
    args: argparse.Namespace, lead: Callable[[argparse.Namespace, "ProcessGroup | None"], int]
) -> int:
    """Run as the rank of the environment; returns the exit code.

    Args:
        args: Arguments of `gscore train`.
        lead: Trains, as rank 0 of a process group or alone.
    """
    from ..trainer.distributed.process_group import (
        ProcessGroup,
        restarted,
        threads_of_rank,
        world_size,
    )

    os.environ.setdefault("GSCORE_THREADS", str(threads_of_rank(cores())))
    size = world_size()
    if restarted() and os.environ["RANK"] == "0":
        _go_on(args)
    if size == 1:
        return lead(args, None)
    with ProcessGroup() as team:
        if team.ended:
            return 0
        return _lead(args, team, lead) if team.is_rank0 else _follow(args, team)


def train_in_turn(
    args: argparse.Namespace, work: Callable[[argparse.Namespace, "ProcessGroup | None"], int]
) -> int:
    """Share work whose pieces each run on one rank; returns the exit code.

    Args:
        args: Arguments of `gscore sequence`.
        work: Does the pieces of this rank; `args` of ranks other than 0 are quiet.
    """
    from ..trainer.distributed.process_group import (
        ProcessGroup,
        RankLostError,
        threads_of_rank,
        world_size,
    )

    os.environ.setdefault("GSCORE_THREADS", str(threads_of_rank(cores())))
    if world_size() == 1:
        return work(args, None)
    with ProcessGroup() as team:
        if team.ended:
            return 0
        if not team.is_rank0:
            args.quiet, args.events, args.json = True, None, False
        try:
            _check_same_arguments(args, team)
            args.port = args.port if team.is_rank0 else None
            return work(args, team)
        except RankLostError:
            if team.is_rank0:
                raise
            return 2
        except GsError:
            if team.notified and not team.is_rank0:
                return 2  # rank 0 printed the reason
            raise


def agent() -> str:
    """Identifier of the torchrun that started this process; the same after its restarts."""
    return f"{platform.node()} {os.getppid()}\n" if under_torchrun() else ""


def _go_on(args: argparse.Namespace) -> None:
    """Continue a run that this torchrun started, from its last checkpoint or from the start."""
    try:
        ours = (args.output / AGENT).read_text(encoding="utf-8") == agent()
    except (OSError, ValueError):
        return
    if ours:
        args.resume = bool(checkpoints_in(args.output))
        args.overwrite = not args.resume
        args.start_checkpoint = args.start_checkpoint if args.overwrite else None


def _lead(
    args: argparse.Namespace,
    team: "ProcessGroup",
    lead: Callable[[argparse.Namespace, "ProcessGroup | None"], int],
) -> int:
    _check_same_arguments(args, team)
    try:
        code = lead(args, team)
    except BaseException:
        _part(team, failed=True)
        raise
    # torchrun restarts a rank that was stopped, and waits for ranks that report their end.
    _part(team, failed=code != 0)
    return code


def _part(team: "ProcessGroup", *, failed: bool) -> None:
    from ..trainer.distributed.process_group import RankLostError

    try:
        team.shutdown(failed=failed)
    except RankLostError:
        return  # a lost rank needs no message


def _follow(args: argparse.Namespace, team: "ProcessGroup") -> int:
    """Run as a worker of rank 0, ignoring signals: all ranks receive them, and rank 0 reacts."""
    from ..trainer.distributed.process_group import RankLostError
    from ..trainer.worker_rank import run_worker

    source = args.source or args.source_option
    with interrupts() as interrupt, interrupt.stopped_by(lambda reason: None, quiet=True):
        try:
            _check_same_arguments(args, team)
            return 0 if run_worker(team, source) else 2
        except RankLostError:
            return 2
        except GsError as error:
            if team.notified:
                return 2
            raise DatasetError(f"Rank {team.rank} ({platform.node()}): {error}") from error


def _check_same_arguments(args: argparse.Namespace, team: "ProcessGroup") -> None:
    from ..trainer.distributed.consistency import check_equal, versions

    check_equal(team, versions() | _given(args))


def _given(args: argparse.Namespace) -> dict[str, Any]:
    given = {name: value for name, value in vars(args).items() if name not in _OWN}
    return {f"the option {name}": str(value) for name, value in given.items() if value is not None}
