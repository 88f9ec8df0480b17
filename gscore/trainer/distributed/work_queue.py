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
from .consistency import all_ready
from .process_group import ProcessGroup, restarted

_PATIENCE = 10.0
"""Seconds to wait for a file that another machine wrote: network folders lag."""


@dataclass(frozen=True, kw_only=True)
class WorkQueue:
    """Shared job queue of a process group."""

    group: ProcessGroup
    output: Path
    """A folder that all ranks reach."""
    agent: str
    """Identifier of the torchrun that restarts lost processes."""

    @property
    def has_started(self) -> bool:
        """True if this torchrun began the work and did not complete it, so that it is resumed."""
        return restarted() and _is_of(self.output, self.agent)

    def work(
        self,
        count: int,
        work: Callable[[Iterator[int], bool], str],
        *,
        resume: bool,
        close: Callable[[], None] = lambda: None,
    ) -> str:
        """Run jobs on this rank until none are left, and wait for the other ranks.

        After a failed job a rank takes no further job; the others continue.

        Args:
            count: Number of jobs.
            work: Runs the jobs of a lazy iterator of numbers from 0; its second argument is rank
                0's `resume`. Returns `finished`, or the reason of a stop.
            resume: On rank 0: whether to resume the results in the folder.
            close: Called on every rank once no rank writes any more.

        Returns:
            `finished`, or the reason of the first stopped rank.

        Raises:
            GsError: this rank's error, that of rank 0, or on rank 0 that of another, with its name.
        """
        group, failure, reason = self.group, None, FINISHED
        with self._kept() as keep:
            self._check_folder()
            group.broadcast({"resume": resume})
            resume = resume if group.is_rank0 else bool(group.receive()["resume"])
            try:
                reason = work(self._turns(count), resume)
            except Cancelled:
                reason = "stopped"
            except Exception as error:
                failure = error
            reasons = group.texts(reason)
            try:
                close()
            except GsError as error:
                failure = failure or error
            with all_ready(group):
                if failure is not None:
                    raise failure
            if group.is_rank0 and all(each == FINISHED for each in reasons):
                group.note_end()
            keep.ended = True
        return next((each for each in reasons if each != FINISHED), FINISHED)

    def _turns(self, count: int) -> Iterator[int]:
        while (turn := self.group.take_turn()) < count:
            yield turn

    @contextmanager
    def _kept(self) -> Iterator["_Keep"]:
        """Keep the torchrun identifier in the folder until the work has ended or left no files."""
        keep = _Keep()
        with all_ready(self.group):
            if self.group.is_rank0:
                atomic_write(self.output / AGENT, self.agent.encode())
        try:
            yield keep
        finally:
            left = any(path.name != AGENT for path in self.output.glob("*"))
            if self.group.is_rank0 and (keep.ended or not left):
                (self.output / AGENT).unlink(missing_ok=True)
                with contextlib.suppress(OSError):
                    self.output.rmdir()  # only an empty folder can be removed

    def _check_folder(self) -> None:
        """Raise ConfigError naming a rank that cannot read the folder of rank 0."""
        agents = self.group.texts(self.agent)
        with all_ready(self.group):
            if not self._appears(agents[0]):
                raise ConfigError(
                    f"{brief(self.output)} is not the folder in which rank 0 writes. All ranks "
                    "need one shared folder for the results, such as a network folder. Without "
                    "one, run the parts one by one with `--frame` or `--block`."
                )

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
