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
"""Seconds after which work that was asked to end is ended."""

_LACKS = re.compile(r"which is not installed|needs the package \w+; install it with")

RUNNING, STOPPING, FINISHED, CANCELLED, FAILED = (
    "running",
    "stopping",
    "finished",
    "cancelled",
    "failed",
)


class VerbJob:
    """One run of a verb; those of one kind say what its events mean."""

    kept = ""
    """The sentence of work that was cancelled."""
    less = ""
    """What to do where memory ran out."""

    def __init__(
        self,
        python: str | Path,
        arguments: Sequence[str],
        *,
        source: Path,
        later: bool = False,
        after: "VerbJob | None" = None,
    ) -> None:
        """Start it.

        Args:
            python: The Python that has gscore.
            arguments: Of `gscore`.
            source: What it works on.
            later: It starts with `begin`, once all that it needs is there.
            after: A job of the same source that was asked to end: it starts by itself once that
                has ended, which this one polls from now on. None: at once.

        Raises:
            OSError: `python` cannot be run.
        """
        self.python, self.source = str(python), source
        self.status = RUNNING
        self.warnings: list[str] = []
        self.sentence = ""
        """How it ended, for people; empty before the end."""
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
        """Whether nothing will change any more."""
        return self.status in (FINISHED, CANCELLED, FAILED)

    @property
    def busy(self) -> bool:
        """Whether it is under way and was not asked to end."""
        return not self.ended and self.status != STOPPING

    def poll(self, budget: float = run_state.BUDGET) -> bool:
        """Take in what it told since the last call; whether something changed."""
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
        """Ask it to end."""
        if self.status != RUNNING:
            return
        if self._process is None and self._after is None:
            self.status, self.sentence = CANCELLED, self.kept
            return
        self.status, self._stopped_at = STOPPING, time.monotonic()
        if self._process is not None:
            self._process.send("stop")

    def leave(self) -> None:
        """Let go because Blender ends: it ends by itself soon."""
        if self._after is not None:
            self._after.leave()
        if self._process is not None:
            self._process.end_input()

    def kill(self, *, wait: float = 0.0) -> None:
        """End it at once."""
        if self._after is not None:
            self._after.kill(wait=wait)
        if self._process is not None:
            self._process.kill(wait=wait)

    def take(self, event: Event) -> None:
        """Take note of an event of its own."""
        raise NotImplementedError

    def takes(self, other: "VerbJob") -> bool:
        """Whether what the job before has done after all is what this one was to do; taken then."""
        return False

    def finish(self) -> str:
        """The sentence of work that came to its end; empty: it did not.

        Raises:
            ValueError: what it told makes no sense.
        """
        raise NotImplementedError

    def _poll_before(self, other: "VerbJob", budget: float) -> bool:
        """Wait for the end of the job before; whether something changed."""
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
        asked = self.status == STOPPING
        try:
            told = self.finish()
        except ValueError as error:
            self.status, self.sentence = FAILED, error_words(error)
            return
        if told:
            self.status, self.sentence = FINISHED, told
        elif asked or (self._failure is not None and self._failure.type == "Cancelled"):
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
                self.sentence += " Make Environment in the add-on's preferences does that too."
