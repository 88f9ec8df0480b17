"""Training under torchrun: rank 0 runs the command, the others work for it."""

import os
import platform
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from ..errors import DatasetError, GsError
from ..io.runs import AGENT, checkpoints_in
from ..live_options import LiveOptions
from ..metrics.machine import cores
from .args.train_request import TrainRequest
from .terminal.interrupt import interrupts, under_torchrun
from .terminal.run_job import OutputOptions

if TYPE_CHECKING:
    from ..trainer.distributed.process_group import ProcessGroup

_OWN = {
    *("source", "source_option", "output", "threads", "resume", "overwrite", "start_checkpoint"),
    *("quiet", "events", "json", "config", "masks"),
}
"""Options that may differ by rank, or that only rank 0 reads."""


def train_distributed(
    request: TrainRequest, lead: Callable[[TrainRequest, "ProcessGroup | None"], int]
) -> int:
    """Run as the rank of the environment, or alone without torchrun; returns the exit code.

    Args:
        request: What to train.
        lead: Trains, as rank 0 of a process group or alone.
    """
    if not under_torchrun():
        return lead(request, None)
    from ..trainer.distributed.process_group import (
        ProcessGroup,
        restarted,
        threads_of_rank,
        world_size,
    )

    os.environ.setdefault("GSCORE_THREADS", str(threads_of_rank(cores())))
    size = world_size()
    if restarted() and os.environ["RANK"] == "0":
        request = _going_on(request)
    if size == 1:
        return lead(request, None)
    with ProcessGroup() as group:
        if group.ended:
            return 0
        return _lead(request, group, lead) if group.is_rank0 else _follow(request, group)


def train_in_turn(
    request: TrainRequest, work: Callable[[TrainRequest, "ProcessGroup | None"], int]
) -> int:
    """Share work whose pieces each run on one rank, or do it alone without torchrun; returns the
    exit code.

    Args:
        request: What to train.
        work: Does the pieces of this rank; the requests of ranks other than 0 are quiet.
    """
    if not under_torchrun():
        return work(request, None)
    from ..trainer.distributed.process_group import (
        ProcessGroup,
        RankLostError,
        threads_of_rank,
        world_size,
    )

    os.environ.setdefault("GSCORE_THREADS", str(threads_of_rank(cores())))
    if world_size() == 1:
        return work(request, None)
    with ProcessGroup() as group:
        if group.ended:
            return 0
        if not group.is_rank0:
            request = replace(request, shown=OutputOptions(quiet=True), live=LiveOptions())
        try:
            _check_same_arguments(request, group)
            return work(request, group)
        except RankLostError:
            if group.is_rank0:
                raise
            return 2
        except GsError:
            if group.notified and not group.is_rank0:
                return 2  # rank 0 printed the reason
            raise


def agent() -> str:
    """Identifier of the torchrun that started this process; the same after its restarts."""
    return f"{platform.node()} {os.getppid()}\n" if under_torchrun() else ""


def _going_on(request: TrainRequest) -> TrainRequest:
    """The request to continue a run that this torchrun started, from its last checkpoint or from
    the start."""
    try:
        ours = (request.output / AGENT).read_text(encoding="utf-8") == agent()
    except (OSError, ValueError):
        return request
    if not ours:
        return request
    resume = bool(checkpoints_in(request.output))
    start = None if resume else request.start_checkpoint
    return replace(request, resume=resume, overwrite=not resume, start_checkpoint=start)


def _lead(
    request: TrainRequest,
    group: "ProcessGroup",
    lead: Callable[[TrainRequest, "ProcessGroup | None"], int],
) -> int:
    _check_same_arguments(request, group)
    try:
        code = lead(request, group)
    except BaseException:
        _part(group, failed=True)
        raise
    # torchrun restarts a rank that was stopped, and waits for ranks that report their end.
    _part(group, failed=code != 0)
    return code


def _part(group: "ProcessGroup", *, failed: bool) -> None:
    from ..trainer.distributed.process_group import RankLostError

    try:
        group.shutdown(failed=failed)
    except RankLostError:
        return  # a lost rank needs no message


def _follow(request: TrainRequest, group: "ProcessGroup") -> int:
    """Run as a worker of rank 0, ignoring signals: all ranks receive them, and rank 0 reacts."""
    from ..trainer.distributed.process_group import RankLostError
    from ..trainer.worker_rank import run_worker

    with interrupts() as interrupt, interrupt.stopped_by(lambda reason: None, quiet=True):
        try:
            _check_same_arguments(request, group)
            return 0 if run_worker(group, request.source) else 2
        except RankLostError:
            return 2
        except GsError as error:
            if group.notified:
                return 2
            raise DatasetError(f"Rank {group.rank} ({platform.node()}): {error}") from error


def _check_same_arguments(request: TrainRequest, group: "ProcessGroup") -> None:
    from ..trainer.distributed.consistency import check_equal, versions

    given = {f"the option {k}": str(v) for k, v in request.given.items() if k not in _OWN}
    check_equal(group, versions() | given)
