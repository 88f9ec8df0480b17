"""Verb job: a gscore command as a background process, its events and its end; no bpy.

`Verb` describes a command; `VerbJob` is one run of it.
"""

import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from ..core import Event, Failed, FrameStarted, GsError, Progress, Warn
from ..interface.lookup import Lookup
from ..interface.option_labels import error_text
from ..process.child_program import Process
from ..process.incremental_tasks import Steps, TaskRunner
from . import run_state

STOP_GRACE = 10.0
"""Seconds after which a cancelled process is killed."""

RUNNING, STOPPING, FINISHED, CANCELLED, FAILED = (
    "running",
    "stopping",
    "finished",
    "cancelled",
    "failed",
)
EventT = TypeVar("EventT", bound=Event)


@dataclass(frozen=True, kw_only=True)
class Verb:
    """Description of a gscore command that runs as a background job."""

    running: str
    """Error if a job of the same source is running, with `{}` for the source."""
    kept: str
    """Message after a cancelled job."""
    less: str
    """Advice after an out-of-memory error."""
    progress: tuple[type[Event], ...]
    """Events with the progress."""
    done: type[Event]
    """The event with the result."""
    message: Callable[["VerbJob"], str]
    """Sentence on the result; ValueError: the result is invalid."""
    complete: tuple[str, ...] = ()
    """Reasons of `done` that count as finished after a cancellation; empty: all."""
    waits: bool = False
    """True if a job starts when a cancelled one of the same source has ended, else it is refused
    until then."""
    adopts: bool = False
    """True if such a job takes over the result, if there still is one."""
    has_place: Callable[["VerbJob"], bool] = lambda job: True
    """False ends the import of a result, which then stays on disk only."""
    expires: tuple[Lookup[Any, Any], ...] = ()
    """Lookups that are outdated when a job has ended."""


class VerbJob:
    """One run of a verb."""

    def __init__(
        self,
        verb: Verb,
        python: str | Path,
        arguments: Sequence[str],
        *,
        source: Path,
        output: Path | None = None,
        scene_uid: int = 0,
        prepare: Callable[[], Steps[object]] | None = None,
        begun: Callable[[], object] = lambda: None,
        arrive: "Callable[[VerbJob], Steps[Iterable[str]]] | None" = None,
        after: "VerbJob | None" = None,
    ) -> None:
        """Start the process.

        Args:
            verb: The command.
            python: The Python that has gscore.
            arguments: Arguments of `gscore`.
            source: Input of the job.
            output: Folder of the results, if it is not derived from `source`.
            scene_uid: Session uid of the scene that started it.
            prepare: Makes input files in steps, of which the first runs here; the process starts
                after the last. None: start immediately.
            begun: Called when the process has passed its checks, at its first frame or result.
            arrive: Imports the result in steps; returns warnings. None: there is nothing to import.
            after: A cancelled job of the same source, which this one polls; the process starts
                when it has ended.

        Raises:
            OSError: `python` cannot be run.
            Any exception of the first step of `prepare`.
        """
        self.verb, self.python, self.source, self.output = verb, str(python), source, output
        self.scene_uid = scene_uid
        self.status = RUNNING
        self.warnings: list[str] = []
        self.sentence = ""
        """Message on the end; empty before it."""
        self.progress: Any = None
        """The last event of `Verb.progress`; None at the beginning and after each frame."""
        self.report: Any = None
        """Facts that `Verb.message` read from the result."""
        self.awaits_import = False
        """True while the result is not imported."""
        self.import_task: TaskRunner | None = None
        """The running import of the result."""
        self.preparing: TaskRunner | None = None
        """Preparation of the input files; None when complete."""
        self._seen: dict[type[Event], Event] = {}
        self._began = time.monotonic()
        self._begun: Callable[[], object] | None = begun
        self._arrive = arrive
        self._failure: Failed | None = None
        self._stopped_at = 0.0
        self._command = [str(python), "-u", "-m", "gscore", *arguments]
        self._process: Process | None = None
        self._after = None if after is None or after.ended else after
        if prepare is not None:
            self.preparing = TaskRunner(prepare())
            self.preparing.step()  # once started, cancelling it cleans up
        elif self._after is None:
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

    @property
    def done(self) -> Any:
        """The event with the result; None before it."""
        return self._seen.get(self.verb.done)

    @property
    def share(self) -> float:
        """Progress from 0 to 1: of the whole job if reported, else of the phase."""
        last, frame = self.progress, self.last(FrameStarted)
        part = 0.0 if last is None else _share(last)
        return part if frame is None else min((frame.place - 1 + part) / max(frame.frames, 1), 1.0)

    @property
    def left(self) -> float | None:
        """Remaining seconds: of the whole job if reported, else of the phase."""
        for name in ("left_s", "eta_s"):
            seconds = getattr(self.progress, name, None)
            if seconds is not None and math.isfinite(seconds):
                return seconds
        return None

    @property
    def elapsed(self) -> float:
        """Seconds since the start."""
        return time.monotonic() - self._began

    def last(self, kind: type[EventT]) -> EventT | None:
        """The last event of a kind."""
        event = self._seen.get(kind)
        return event if isinstance(event, kind) else None

    def poll(self, budget: float = run_state.BUDGET) -> bool:
        """Process events since the last call; True if something changed."""
        if self._after is not None:
            return self._poll_before(self._after, budget)
        if self.ended or self._process is None:
            return False
        changed = False
        for event in run_state.events(self._process.lines(budget)):
            changed = True
            self._take(event)
        if self._process.ended:
            self._end()
            return True
        if self.status == STOPPING and time.monotonic() - self._stopped_at > STOP_GRACE:
            self._process.kill()
        return changed

    def prepare_step(self, begin: Callable[[], object]) -> bool:
        """Run the next step of `preparing`, and `begin` after the last; True if it ended."""
        try:
            if self.ended:
                self.preparing.cancel()
            elif not self.preparing.step():
                return False
            else:
                begin()
        except Exception as error:  # any error: the process cannot begin without its files
            self.status, self.sentence = FAILED, error_text(error) or type(error).__name__
        self.preparing = None
        return True

    def arrive_step(self, with_readable_errors: Callable[[Steps[Any]], Steps[Any]]) -> bool:
        """Run the next step of the import; True if it ended.

        Args:
            with_readable_errors: Wraps the import, to turn errors of Blender and memory into
                messages.
        """
        if self.import_task is None:
            self.import_task = TaskRunner(with_readable_errors(self._arrive(self)))
        ended = True
        try:
            ended = self.import_task.step()
            if ended:
                self.warnings += self.import_task.result
        except (GsError, ValueError, OSError) as error:
            self.warnings.append(error_text(error))
        finally:
            if ended:
                self.import_task, self.awaits_import = None, False
        return ended

    def give_up(self) -> None:
        """End the import, whose result stays on disk."""
        if self.import_task is not None:
            self.import_task.cancel()
        self.import_task, self.awaits_import = None, False

    def cancel(self) -> None:
        """Cancel the job."""
        if self.status != RUNNING:
            return
        if self._process is None and self._after is None:
            self.status, self.sentence = CANCELLED, self.verb.kept
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

    def _take(self, event: Event) -> None:
        self._seen[type(event)] = event
        if isinstance(event, Failed):
            self._failure = event
        elif isinstance(event, Warn):
            self.warnings.append(event.message)
        elif isinstance(event, self.verb.progress):
            self.progress = event
        elif isinstance(event, FrameStarted | self.verb.done) and self._begun is not None:
            self._begun()
            self._begun = None
        if isinstance(event, FrameStarted):
            self.progress = None

    def _message(self) -> str:
        """Message on a finished job; empty: it did not finish.

        Raises:
            ValueError: its result is invalid.
        """
        done, complete = self.done, self.verb.complete
        if done is None or (self.status == STOPPING and complete and done.reason not in complete):
            return ""
        message = self.verb.message(self)
        self.awaits_import = self._arrive is not None
        return message

    def _poll_before(self, other: "VerbJob", budget: float) -> bool:
        """Poll the previous job until it ends; True if something changed."""
        other.poll(budget)
        if not other.ended:
            return False
        self._after = None
        if self.status == STOPPING:
            self.status, self.sentence = CANCELLED, self.verb.kept
            return True
        if other.status == FINISHED and self.verb.adopts and other.done is not None:
            self._seen[self.verb.done] = other.done
            self.status, self.sentence = FINISHED, self._message()
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
            message = self._message()
        except ValueError as error:
            self.status, self.sentence = FAILED, error_text(error)
            return
        if message:
            self.status, self.sentence = FINISHED, message
        elif cancelled or (self._failure is not None and self._failure.type == "Cancelled"):
            self.status, self.sentence = CANCELLED, self.verb.kept
        else:
            self.status = FAILED
            self.sentence = run_state.failure_sentence(
                self._failure,
                self._process.returncode,
                self._process.stderr_tail,
                python=self.python,
                less=self.verb.less,
            )


def _share(last: Any) -> float:
    """Share of an event of `Verb.progress`."""
    whole = getattr(last, "share", None)
    if whole is not None and math.isfinite(whole):
        return whole
    steps = isinstance(last, Progress)
    done, total = (last.step, last.iterations) if steps else (last.done, last.total)
    return min(done / total, 1.0) if total > 0 else 0.0
