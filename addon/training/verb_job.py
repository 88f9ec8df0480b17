"""Verb job: a gscore command as a background process, its events and its end; no bpy."""

import re
import time
from collections.abc import Sequence
from pathlib import Path

from ..core import Event, Failed, Warn
from ..interface.option_labels import error_words
from ..process.child_program import Process
from . import run_state

STOP_GRACE = 10.0
"""Seconds after which a cancelled process is killed."""

_LACKS = re.compile(r"which is not installed|needs the package \w+; install it with")

RUNNING, STOPPING, FINISHED, CANCELLED, FAILED = (
    "running",
    "stopping",
    "finished",
    "cancelled",
    "failed",
)


class VerbJob:
    """One run of a verb; subclasses interpret its events."""

    kept = ""
    """Message after a cancelled job."""
    less = ""
    """Advice after an out-of-memory error."""

    def __init__(
        self,
        python: str | Path,
        arguments: Sequence[str],
        *,
        source: Path,
        later: bool = False,
        after: "VerbJob | None" = None,
    ) -> None:
        """Start the process.

        Args:
            python: The Python that has gscore.
            arguments: Arguments of `gscore`.
            source: Input of the job.
            later: Wait for `begin`, until all inputs exist.
            after: A cancelled job of the same source, which this one polls; the process starts
                when it has ended. None: start immediately.

        Raises:
            OSError: `python` cannot be run.
        """
        self.python, self.source = str(python), source
        self.status = RUNNING
        self.warnings: list[str] = []
        self.sentence = ""
        """Message on the end; empty before it."""
        self._failure: Failed | None = None
        self._stopped_at = 0.0
        self._command = [str(python), "-u", "-m", "gscore", *arguments]
        self._process: Process | None = None
        self._after = None if after is None or after.ended else after
        if not later and self._after is None:
            self.begin()

    def begin(self) -> None:
        """Start the process.

        Raises:
            OSError: the Python cannot be run.
        """
        self._process = Process(self._command)

    @property
    def ended(self) -> bool:
        """True if the job has ended."""
        return self.status in (FINISHED, CANCELLED, FAILED)

    @property
    def busy(self) -> bool:
        """True if it is running and was not cancelled."""
        return not self.ended and self.status != STOPPING

    def poll(self, budget: float = run_state.BUDGET) -> bool:
        """Process events since the last call; True if something changed."""
        if self._after is not None:
            return self._poll_before(self._after, budget)
        if self.ended or self._process is None:
            return False
        changed = False
        for event in run_state.events(self._process.lines(budget)):
            changed = True
            if isinstance(event, Failed):
                self._failure = event
            elif isinstance(event, Warn):
                self.warnings.append(event.message)
            else:
                self.take(event)
        if self._process.ended:
            self._end()
            return True
        if self.status == STOPPING and time.monotonic() - self._stopped_at > STOP_GRACE:
            self._process.kill()
        return changed

    def cancel(self) -> None:
        """Cancel the job."""
        if self.status != RUNNING:
            return
        if self._process is None and self._after is None:
            self.status, self.sentence = CANCELLED, self.kept
            return
        self.status, self._stopped_at = STOPPING, time.monotonic()
        if self._process is not None:
            self._process.send("stop")

    def leave(self) -> None:
        """Release the job because Blender quits: the process ends soon."""
        if self._after is not None:
            self._after.leave()
        if self._process is not None:
            self._process.end_input()

    def kill(self, *, wait: float = 0.0) -> None:
        """Kill the process."""
        if self._after is not None:
            self._after.kill(wait=wait)
        if self._process is not None:
            self._process.kill(wait=wait)

    def take(self, event: Event) -> None:
        """Process an event of this verb."""
        raise NotImplementedError

    def takes(self, other: "VerbJob") -> bool:
        """Take over the result of the previous job; True if it has one."""
        return False

    def finish(self) -> str:
        """Message on a finished job; empty: it did not finish.

        Raises:
            ValueError: its result is invalid.
        """
        raise NotImplementedError

    def _poll_before(self, other: "VerbJob", budget: float) -> bool:
        """Poll the previous job until it ends; True if something changed."""
        other.poll(budget)
        if not other.ended:
            return False
        self._after = None
        if self.status == STOPPING:
            self.status, self.sentence = CANCELLED, self.kept
            return True
        if other.status == FINISHED and self.takes(other):
            self.status, self.sentence = FINISHED, self.finish()
            return True
        try:
            self.begin()
        except OSError as error:
            self.status = FAILED
            self.sentence = f"{self.python} cannot be run ({error.strerror or error})."
        return True

    def _end(self) -> None:
        cancelled = self.status == STOPPING
        try:
            message = self.finish()
        except ValueError as error:
            self.status, self.sentence = FAILED, error_words(error)
            return
        if message:
            self.status, self.sentence = FINISHED, message
        elif cancelled or (self._failure is not None and self._failure.type == "Cancelled"):
            self.status, self.sentence = CANCELLED, self.kept
        else:
            self.status = FAILED
            failure = run_state.failure_sentence(
                self._failure,
                self._process.returncode,
                self._process.stderr_tail,
                python=self.python,
                less=self.less,
            )
            self.sentence = failure
            if _LACKS.search(failure):
                self.sentence += " Make Environment in the add-on's preferences installs it too."
