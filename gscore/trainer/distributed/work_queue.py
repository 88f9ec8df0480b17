"""Work queue: independent jobs in a shared folder, each done once by any free process."""

import contextlib
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ...errors import Cancelled, ConfigError, GsError
from ...events import FINISHED
from ...io.files import atomic_write
from ...io.runs import AGENT
from ...quoting import brief
from .consistency import check_ready
from .process_group import ProcessGroup, restarted

_PATIENCE = 10.0
"""Seconds after which a file that another machine wrote is not there: network folders lag."""


@dataclass(frozen=True, kw_only=True)
class WorkQueue:
    """Where a team works, and for whom."""

    team: ProcessGroup
    output: Path
    """A folder that all ranks reach."""
    agent: str
    """Of the torchrun that starts the team again where a process is lost."""

    @property
    def has_started(self) -> bool:
        """Whether this torchrun has begun the work and not ended it, so that it is gone on with."""
        return restarted() and _is_of(self.output, self.agent)

    def work(
        self,
        count: int,
        work: Callable[[Iterator[int], bool], str],
        *,
        resume: bool,
        close: Callable[[], None] = lambda: None,
    ) -> str:
        """Do what this rank gets of it, and hear how the others ended.

        A rank whose piece fails takes no other; the others go on until nothing is left.

        Args:
            count: Pieces there are.
            work: Does the pieces of an iterator, numbers from 0, which goes on only where it is
                asked to; gets too what rank 0 says of going on. Returns `finished`, or why it was
                stopped.
            resume: On rank 0: whether what lies in the folder is gone on with.
            close: Called on every rank once no rank writes any more.

        Returns:
            `finished`, or why the first rank that was stopped was.

        Raises:
            GsError: this rank's error, that of rank 0, or on rank 0 that of another, with its name.
        """
        team, failure, reason = self.team, None, FINISHED
        with self._kept() as keep:
            self._check_seen()
            team.broadcast({"resume": resume})
            resume = resume if team.is_rank0 else bool(team.receive()["resume"])
            try:
                reason = work(self._turns(count), resume)
            except Cancelled:
                reason = "stopped"
            except Exception as error:
                failure = error
            reasons = team.texts(reason)
            try:
                close()
            except GsError as error:
                failure = failure or error
            check_ready(team, failure)
            if team.is_rank0 and all(told == FINISHED for told in reasons):
                team.note_end()
            keep.ended = True
        return next((told for told in reasons if told != FINISHED), FINISHED)

    def _turns(self, count: int) -> Iterator[int]:
        while (turn := self.team.take_turn()) < count:
            yield turn

    @contextmanager
    def _kept(self) -> Iterator["_Keep"]:
        """Say in the folder whose work it is, until that has ended or left nothing."""
        keep, failure = _Keep(), None
        try:
            if self.team.is_rank0:
                atomic_write(self.output / AGENT, self.agent.encode())
        except GsError as error:
            failure = error
        check_ready(self.team, failure)
        try:
            yield keep
        finally:
            left = any(path.name != AGENT for path in self.output.glob("*"))
            if self.team.is_rank0 and (keep.ended or not left):
                (self.output / AGENT).unlink(missing_ok=True)
                with contextlib.suppress(OSError):
                    self.output.rmdir()  # only an empty folder can be removed

    def _check_seen(self) -> None:
        """Raise ConfigError unless all have the folder of rank 0; it is named who has not."""
        agents, failure = self.team.texts(self.agent), None
        if not self._appears(agents[0]):
            failure = ConfigError(
                f"{brief(self.output)} is not the folder in which rank 0 writes. All need one "
                "folder for the results, such as one on a network. Where there is none, do the "
                "parts one by one, with --frame or --block."
            )
        check_ready(self.team, failure)

    def _appears(self, agent: str) -> bool:
        end = time.monotonic() + _PATIENCE
        while not _is_of(self.output, agent):
            if time.monotonic() > end:
                return False
            time.sleep(0.05)
        return True


@dataclass
class _Keep:
    ended: bool = False


def _is_of(output: Path, agent: str) -> bool:
    try:
        return bool(agent) and (output / AGENT).read_text(encoding="utf-8") == agent
    except (OSError, ValueError):
        return False
