"""`gscore depth` beside Blender: its process, how far it is and what came out; no bpy."""

import time
from collections.abc import Sequence
from pathlib import Path

from ..capture import depth_maps
from ..capture.depth_maps import DepthReport
from ..core import DepthDone, DepthProgress, Failed, Warn
from ..job import session
from ..process.program import Process

BUDGET = 0.005
"""Seconds that a poll may spend on lines."""
STOP_GRACE = 10.0
"""Seconds after which work that was asked to end is ended; maps are written whole or not at all."""

RUNNING, STOPPING, FINISHED, CANCELLED, FAILED = (
    "running",
    "stopping",
    "finished",
    "cancelled",
    "failed",
)


class DepthJob:
    """One run of `gscore depth`."""

    def __init__(self, python: str | Path, arguments: Sequence[str], *, source: Path) -> None:
        """Start it.

        Args:
            python: The Python that has gscore.
            arguments: Of `gscore`, see `options.depth_run`.
            source: Folder of the capture.

        Raises:
            OSError: `python` cannot be run.
        """
        self.python, self.source = str(python), source
        self.status = RUNNING
        self.progress: DepthProgress | None = None
        self.warnings: list[str] = []
        self.report: DepthReport | None = None
        """The table, once it has finished."""
        self.done: DepthDone | None = None
        self.sentence = ""
        """How it ended, for people; empty before the end."""
        self._failure: Failed | None = None
        self._stopped_at = 0.0
        self._process = Process([str(python), "-u", "-m", "gscore", *arguments])

    @property
    def ended(self) -> bool:
        """Whether nothing will change any more."""
        return self.status in (FINISHED, CANCELLED, FAILED)

    @property
    def share(self) -> float:
        """Part of the phase that is under way, 0 to 1."""
        told = self.progress
        return min(told.done / told.total, 1.0) if told is not None and told.total > 0 else 0.0

    def poll(self, budget: float = BUDGET) -> bool:
        """Take in what it told since the last call; whether something changed."""
        if self.ended:
            return False
        changed = False
        for line in self._process.lines(budget):
            event = session.read_event(line)
            changed |= event is not None
            if isinstance(event, DepthProgress):
                self.progress = event
            elif isinstance(event, DepthDone):
                self.done = event
            elif isinstance(event, Failed):
                self._failure = event
            elif isinstance(event, Warn):
                self.warnings.append(event.message)
        if self._process.ended:
            self._end()
            return True
        if self.status == STOPPING and time.monotonic() - self._stopped_at > STOP_GRACE:
            self._process.kill()
        return changed

    def cancel(self) -> None:
        """Ask it to end; maps that are predicted stay, and the next prediction goes on there."""
        if self.status == RUNNING:
            self.status, self._stopped_at = STOPPING, time.monotonic()
            self._process.send("stop")

    def leave(self) -> None:
        """Let go because Blender ends: it ends after the view that is under way."""
        self._process.end_input()

    def kill(self, *, wait: float = 0.0) -> None:
        """End it at once."""
        self._process.kill(wait=wait)

    def _end(self) -> None:
        done, asked = self.done, self.status == STOPPING
        if done is not None:
            try:
                self.report = depth_maps.from_table(done.table, why=done.why)
            except ValueError as error:
                self.status, self.sentence = FAILED, str(error)
                return
            self.status, self.sentence = FINISHED, _sentence(done, self.report)
        elif asked or (self._failure is not None and self._failure.type == "Cancelled"):
            self.status, self.sentence = CANCELLED, "Cancelled; maps that were made are kept."
        else:
            self.status = FAILED
            self.sentence = session.failure_sentence(
                self._failure,
                self._process.returncode,
                self._process.stderr_tail,
                python=self.python,
                less="choose a smaller network, then predict again",
            )
            if "onnxruntime, which is not installed" in self.sentence:
                self.sentence += " Make Environment in the add-on's preferences does that too."


def _sentence(done: DepthDone, report: DepthReport) -> str:
    maps = len(report.rows) - report.counts[depth_maps.MISSING]
    made = f"{done.predicted} maps predicted. " if done.predicted else ""
    return f"{made}{done.accepted} of {maps} maps are accepted."
