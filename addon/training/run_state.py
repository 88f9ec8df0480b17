"""Run state: progress of a run, built from the events of its trainer; no bpy."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, get_origin

from ..core import (
    Decision,
    Done,
    Eval,
    Event,
    Failed,
    Preview,
    Progress,
    Saved,
    Snapshot,
    Started,
    Warn,
    from_line,
    headline_psnr,
)
from ..interface.option_labels import panel_text
from .curve import Curve

_CPU = "cpu"
BUDGET = 0.005
"""Maximum duration of reading output in a poll, seconds."""
_WARNINGS_KEPT = 50
_ENDS = {
    "finished": "Finished",
    "converged": "Finished early, no more to learn,",
    "target": "Finished early, the target PSNR was reached,",
}
"""Words for the reasons of trainings that need no more steps."""

STARTING, RUNNING, PAUSED, STOPPING = "starting", "running", "paused", "stopping"
FINISHED, STOPPED, FAILED, DISCARDED = "finished", "stopped", "failed", "discarded"
ENDED = (FINISHED, STOPPED, FAILED, DISCARDED)
"""Values of `RunState.status`; those of ENDED are final."""


PYTHON_FAILED = 1
"""Exit code of a Python that cannot run gscore; gscore itself sends its errors as events."""


def read_event(line: str) -> Event | None:
    """The event in a line of the trainer's output; None for other lines and invalid events."""
    event = from_line(line)
    if event is None:
        return None
    for f in fields(event):
        value = getattr(event, f.name)
        kind = get_origin(f.type) or f.type
        # Strict JSON has null for numbers that are not finite.
        kinds = (int, float, type(None)) if kind is float else kind
        if isinstance(value, bool) != (kind is bool) or not isinstance(value, kinds):
            return None
    if isinstance(event, Warn | Failed):
        return replace(event, message=panel_text(event.message))
    return event


def events(lines: Iterable[str]) -> Iterator[Event]:
    """The events in lines of a program's output; other lines are skipped."""
    for line in lines:
        event = read_event(line)
        if event is not None:
            yield event


@dataclass
class RunState:
    """Progress of a run."""

    status: str = STARTING
    step: int = 0
    iterations: int = 0
    loss: float | None = None
    psnr: float | None = None
    """Smoothed over training views, dB."""
    splats: int = 0
    steps_per_s: float = 0.0
    eta_s: float | None = None
    elapsed_s: float = 0.0
    """Seconds spent in steps."""
    phase: str = "starting the trainer"
    curve: Curve = field(default_factory=Curve)
    warnings: list[str] = field(default_factory=list)
    """Unique warnings, the latest last."""
    started: Started | None = None
    replaces_card: bool = False
    """Whether the CPU trains because a graphics card failed."""
    preview: Preview | None = None
    snapshot: Snapshot | None = None
    checkpoint: Path | None = None
    checkpoint_step: int = 0
    result: Path | None = None
    """point_cloud.ply, written completely."""
    metrics: dict[str, Any] = field(default_factory=dict)
    """Metrics of the last evaluation, with `split`."""
    failure: Failed | None = None
    done: Done | None = None
    sentence: str = ""
    """Message on the end; empty before it."""

    @property
    def decisions(self) -> list[Decision]:
        """Decisions of the training for this capture, with panel labels in their texts."""
        found = self.started.decisions if self.started else ()
        return [replace(one, text=panel_text(one.text)) for one in found]

    @property
    def ended(self) -> bool:
        """True after the end."""
        return self.status in ENDED

    @property
    def share(self) -> float:
        """Share of the steps taken, 0 to 1."""
        return min(self.step / self.iterations, 1.0) if self.iterations else 0.0

    def apply(self, event: Event) -> None:
        """Update the state from an event."""
        match event:
            case Started():
                self._started(event)
            case Progress():
                self._progress(event)
            case Preview():
                self.preview = event
            case Snapshot():
                self.snapshot = event
            case Eval():
                self.metrics = {**event.metrics, "split": event.split, "step": event.step}
            case Warn():
                self.warn(event.message)
            case Saved():
                self._saved(Path(event.path), event.step)
            case Done():
                self._done(event)
            case Failed():
                self.failure = event

    @property
    def device(self) -> str:
        """Name of the device that trains; empty before the first step."""
        if self.started is None:
            return ""
        if self.started.device != _CPU:
            return self.started.device
        return "CPU, without a graphics card" if self.replaces_card else "CPU"

    def warn(self, message: str) -> None:
        """Add a warning as the latest; removes an equal earlier one."""
        self.warnings = [w for w in self.warnings if w != message][-_WARNINGS_KEPT + 1 :]
        self.warnings.append(message)

    def end(self, code: int | None, stderr: Sequence[str], *, python: str) -> None:
        """Set the final status after the process has ended.

        Args:
            code: Exit code, negative for a signal.
            stderr: The last lines of the error output.
            python: The Python that ran it, for messages.
        """
        if self.ended:
            return
        self.eta_s = None
        if self.done is not None and self.failure is None:
            self.status = FINISHED if self.done.reason in _ENDS else STOPPED
            self.sentence = _done_sentence(self.done)
        elif self.failure is not None and self.failure.type == "Cancelled":
            self.status, self.sentence = STOPPED, "Stopped before the first step."
        else:
            self.status = FAILED
            of_card = {}
            if self.started is not None and self.started.device != _CPU:
                of_card = {
                    "cause": f"memory ran out or the driver of {self.started.device} crashed",
                    "less": "use fewer splats, smaller photos or the CPU, then Resume",
                }
            self.sentence = failure_sentence(self.failure, code, stderr, python=python, **of_card)
            if self.checkpoint is not None:
                self.sentence += f" Resume continues from step {self.checkpoint_step:,}."

    def _started(self, event: Started) -> None:
        failed = self.started is not None and self.started.device != _CPU
        self.replaces_card = event.device == _CPU and failed
        self.started = event
        self.step, self.iterations, self.splats = event.step, event.iterations, event.splats
        self.phase = "first steps"
        if self.status == STARTING:
            self.status = RUNNING

    def _progress(self, event: Progress) -> None:
        self.step, self.iterations = event.step, event.iterations
        self.phase, self.elapsed_s = event.phase, event.elapsed_s
        self.steps_per_s = event.steps_per_s or 0.0
        self.splats = event.splats or self.splats
        self.loss, self.psnr = _finite(event.loss), _finite(event.psnr)
        self.eta_s = _finite(event.eta_s)
        if self.loss is not None and self.psnr is not None and event.step > 0:
            self.curve.add(event.step, self.loss, self.psnr)
        if self.status in (RUNNING, PAUSED):
            self.status = PAUSED if event.phase == "paused" else RUNNING

    def _saved(self, path: Path, step: int) -> None:
        if path.suffix == ".safetensors":
            self.checkpoint, self.checkpoint_step = path, step
        elif path.name == "point_cloud.ply" and path.parent.parent.name != "point_cloud":
            self.result = path

    def _done(self, event: Done) -> None:
        self.done = event
        self.step, self.splats = event.step, event.splats
        self.result = Path(event.path)
        if event.metrics:
            self.metrics = {**event.metrics, "step": event.step}


def failure_sentence(
    failure: Failed | None,
    code: int | None,
    stderr: Sequence[str],
    *,
    python: str,
    cause: str = "memory ran out",
    less: str = "use fewer splats or smaller photos, then Resume",
) -> str:
    """Cause and remedy of a failed gscore process.

    Args:
        failure: Its own error event, if any.
        code: Exit code, negative for a signal.
        stderr: The last lines of the error output.
        python: The Python that ran it.
        cause: Likely cause of an end by a signal.
        less: Advice against it.
    """
    if failure is not None:
        advice = (
            f" Make Environment in the add-on's preferences installs it too; {python} was used."
        )
        return _sentence(failure.message) + (advice if failure.package else "")
    if code is not None and code < 0:
        return (
            f"The process was ended from outside by signal {-code}; unless you ended it, {cause}: "
            f"{less}."
        )
    last = next((line.strip() for line in reversed(stderr) if line.strip()), "")
    output = f' Its last output: "{last[:200]}".' if last else ""
    if code == PYTHON_FAILED:
        return (
            f"{python} cannot run gscore.{output} Press Make Environment in the add-on's "
            "preferences, or choose another Python there."
        )
    return (
        f"The process ended early (exit code {code}).{output} Press Check in the add-on's "
        f"preferences to test {python}."
    )


def _done_sentence(done: Done) -> str:
    quality = headline_psnr(done.metrics)
    views = {"test": " on test views", "train": " on training views"}
    where = views.get(str(done.metrics.get("split")), "")
    tail = f", PSNR {quality:.2f} dB{where}" if isinstance(quality, int | float) else ""
    count = f"{done.splats:,} splats{tail}"
    if done.reason in _ENDS:
        return f"{_ENDS[done.reason]} after {done.step:,} steps: {count}."
    return f"Stopped at step {done.step:,} with a checkpoint: {count}. Resume continues from there."


def _sentence(text: str) -> str:
    text = text.strip().splitlines()[0] if text.strip() else "The trainer gave no reason"
    text = text[0].upper() + text[1:]
    return text if text.endswith((".", "!", "?")) else text + "."


def _finite(value: float | None) -> float | None:
    """A float; None for null, NaN or infinity."""
    good = isinstance(value, int | float) and math.isfinite(value)
    return float(value) if good else None
