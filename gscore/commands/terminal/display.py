"""Display of events: JSON lines for programs, progress lines for users, or nothing."""

import contextlib
import math
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TextIO

from ...events import (
    DepthDone,
    DepthProgress,
    Done,
    Estimated,
    Eval,
    EvalDone,
    EvalProgress,
    Event,
    Failed,
    FramesDone,
    FramesProgress,
    FrameStarted,
    MeshDone,
    MeshPlanned,
    MeshProgress,
    Progress,
    RefitDone,
    RefitProgress,
    Saved,
    SequenceDone,
    SfmDone,
    SfmEstimated,
    SfmProgress,
    Started,
    Warn,
    to_line,
)
from ...text_format import count_text, number, quality_text, size_text, time_text
from .status import Status, clock

_STOPS = ("comparing photos", "paused", "measuring")
"""Phases without steps, which are shown; the number of splats implies the others."""


class JsonLines:
    """Each event as a line of JSON."""

    def __init__(self, stream: TextIO, *, on_closed: Callable[[], None]) -> None:
        """Write to `stream`; `on_closed` is called once when its reader closes it."""
        self._stream = stream
        self._on_closed = on_closed
        self._open = True

    def __call__(self, event: Event) -> None:
        """Write the event immediately."""
        if not self._open:
            return
        try:
            self._stream.write(to_line(event) + "\n")
            self._stream.flush()
        except (OSError, ValueError):
            self._open = False
            # Python flushes stdout at exit, which would fail again, with a traceback.
            with contextlib.suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())
            self._on_closed()


class Lines:
    """Events as lines of text, with a progress line below them on a terminal.

    The last measurement and its files are left out, because the verb prints them on stdout at its
    end; but those of a sequence's frames are shown, as the verb prints only their mean.
    """

    def __init__(self, stream: TextIO) -> None:
        self._status = Status(stream)
        self._measured = ""
        self._found = ""
        """Result of a search for cameras, which the verb prints itself if nothing follows."""
        self._sequence = False
        self._status.show(["Starting"])

    def __call__(self, event: Event) -> None:
        """Show the event."""
        if self._found:
            self._status.print_line(self._found)
            self._found = ""
        match event:
            case Progress():
                self._progress(event)
            case DepthProgress():
                self._depth(event)
            case EvalProgress():
                self._evaluation(event)
            case RefitProgress():
                self._refit(event)
            case MeshProgress():
                self._mesh(event)
            case SfmProgress():
                self._sfm(event)
            case Eval():
                self._measured = eval_text(event)
            case FramesProgress():
                self._frames(event)
            case (
                Done() | DepthDone() | EvalDone() | SequenceDone() | FramesDone() | RefitDone()
                | MeshDone() | Failed()
            ):  # fmt: skip
                self._end()
            case SfmDone():
                self._end()
                self._found = sfm_text(event)
            case Saved():
                self._saved(event)
            case FrameStarted():
                self._sequence = True
                self._status.print_line(frame_text(event))
            case _:
                for text in _texts(event):
                    self._status.print_line(text)

    def _progress(self, event: Progress) -> None:
        self._show_measured()  # the run continues, so this was not the last
        share = event.step / max(event.iterations, 1) if event.splats else None
        last = event.step >= event.iterations and event.phase not in _STOPS
        self._status.show(progress_parts(event), share=share, immediate=last)

    def _depth(self, event: DepthProgress) -> None:
        if not event.done:
            self._status.show([_capital(event.phase)])
            return
        parts = [f"{clock(event.eta_s)} left", f"{event.phase} {event.done} of {event.total}"]
        last = event.done == event.total
        share = event.done / event.total
        self._status.show([*parts, event.view], share=share, immediate=last)

    def _evaluation(self, event: EvalProgress) -> None:
        if not event.done:
            self._status.show([event.view or "Reading"])
            return
        parts = [f"{clock(event.eta_s)} left", f"view {event.done} of {event.total}", event.view]
        last = event.done == event.total
        self._status.show(parts, share=event.done / event.total, immediate=last)

    def _refit(self, event: RefitProgress) -> None:
        if not event.done:
            self._status.show([_capital(event.phase)])
            return
        what = "step" if event.phase == "fitting" else "picture"
        parts = [f"{event.phase}, {what} {number(event.done)} of {number(event.total)}"]
        left = [f"{clock(event.eta_s)} left"] if math.isfinite(event.eta_s) else []
        self._status.show([*left, *parts], share=event.done / event.total)

    def _mesh(self, event: MeshProgress) -> None:
        if not event.done:
            # The phases after the views take long, and most of them have no further progress.
            self._status.show([_capital(event.phase)], immediate=True)
            return
        left = [f"{clock(event.eta_s)} left"] if math.isfinite(event.eta_s) else []
        what = "part" if event.phase == "contouring" else "view"
        parts = [*left, f"{event.phase}, {what} {event.done} of {event.total}"]
        self._status.show(parts, share=event.done / event.total)

    def _sfm(self, event: SfmProgress) -> None:
        what = "pair" if event.phase == "comparing photos" else "photo"
        parts = [event.phase]
        if event.done:
            parts = [f"{event.phase}, {what} {number(event.done)} of {number(event.total)}"]
        if math.isfinite(event.left_s):
            parts = [f"{clock(event.left_s)} left", *parts]
        else:
            parts[0] = _capital(parts[0])
        self._status.show(parts, share=event.share if math.isfinite(event.share) else None)

    def _frames(self, event: FramesProgress) -> None:
        if not event.done:
            self._status.show([_capital(event.phase)])
            return
        parts = [f"{event.phase}, {event.done} of {event.total or 'an unknown number'}"]
        if event.eta_s == event.eta_s:
            parts = [f"{clock(event.eta_s)} left", *parts]
        share = min(event.done / event.total, 1.0) if event.total else None
        self._status.show(parts, share=share)

    def _saved(self, event: Saved) -> None:
        is_requested = "point_cloud/iteration_" in Path(event.path).as_posix()
        if is_requested:
            self._status.print_line(f"Saved {event.path}")

    def _show_measured(self) -> None:
        if self._measured:
            self._status.print_line(self._measured)
        self._measured = ""

    def _end(self) -> None:
        if self._sequence:
            self._show_measured()
        self._measured = ""
        self._status.clear()


def _texts(event: Event) -> Iterator[str]:
    """Lines about an event that stay."""
    match event:
        case Estimated():
            yield estimate_text(event)
        case SfmEstimated():
            yield (
                f"Finding the cameras of {count_text(event.photos, 'photo')}, which takes about "
                f"{time_text(float(f'{event.seconds:.1g}'))} on an otherwise idle machine"
            )
        case MeshPlanned():
            yield (
                f"{count_text(event.views, 'view')}; voxels of {event.voxel:.3g} world units near "
                f"surfaces up to a depth of {event.far:.3g}: {size_text(event.volume_bytes)}"
            )
        case Started() if event.step:
            # The decisions on the photos were shown when the run began.
            yield resumed_text(event)
            yield from filter(None, [event.decision("viewer")])
        case Started():
            yield (
                f"{count_text(event.train_views, 'training view')}, "
                f"{count_text(event.test_views, 'test view')}, "
                f"{event.width} x {event.height} px"
            )
            # A card's training has no threads of its own.
            threads = [count_text(event.threads, "thread")] if event.threads else []
            on = ", ".join([*threads, event.isa])
            yield f"{count_text(event.splats, 'splat')} to start with{_each(event)}; {on}"
            yield from (decision.text for decision in event.decisions)
        case Warn():
            yield f"Warning: {event.message}"


def resumed_text(event: Started) -> str:
    """The step and remaining time of a resumed training, as text."""
    left = ""
    if math.isfinite(event.left_s):
        left = f", about {time_text(max(round(event.left_s), 1))} of training left"
    return (
        f"Resuming from step {number(event.step)} of {number(event.iterations)} with "
        f"{count_text(event.splats, 'splat')}{left}; {count_text(event.threads, 'thread')}, "
        f"{event.isa}"
    )


def _each(event: Started) -> str:
    """Note on several models, each of which starts from all points."""
    if event.models == 1:
        return ""
    each = event.splats // event.models
    return f", the same {number(each)} for each of {count_text(event.models, 'model')}"


def progress_parts(event: Progress) -> list[str]:
    """Parts of the progress line, the most important first."""
    if not event.splats:
        return [_capital(event.phase)]
    step = f"step {number(event.step)} of {number(event.iterations)}"
    parts = [step, f"PSNR {event.psnr:.1f} dB", count_text(event.splats, "splat")]
    if event.phase in _STOPS:
        return [event.phase, *parts]
    if event.steps_per_s:
        parts = [f"{clock(event.eta_s)} left", *parts, f"{event.steps_per_s:.1f} steps/s"]
    return parts


def frame_text(event: FrameStarted) -> str:
    """One line on the next frame of a sequence."""
    how = "complete already" if event.complete else count_text(event.iterations, "step")
    how += ", from the previous frame" if event.start and not event.complete else ""
    return f"Frame {event.frame} ({event.place} of {event.frames}): {how}"


def eval_text(event: Eval) -> str:
    """One line on a measurement; empty for the PSNR of a stopping criterion."""
    if event.metrics.get("ssim") is None:
        return ""
    return f"Step {number(event.step)}, {event.split} views: {quality_text(event.metrics)}"


def sfm_text(event: SfmDone) -> str:
    """One line on the cameras that were found."""
    return (
        f"Found the cameras of {number(event.registered)} of {count_text(event.photos, 'photo')} "
        f"in {time_text(event.seconds)}; mean reprojection error {event.reprojection_px:.2f} px"
    )


def estimate_text(event: Estimated) -> str:
    """Expected time and memory of a training, as text."""
    text = f"About {time_text(max(round(event.seconds), 1))} of training"
    if event.device_bytes:
        text += " (estimated: no device of this kind was measured)"
    if event.reading_seconds > max(1.0, 0.1 * event.seconds):
        text += f" after {time_text(round(event.reading_seconds))} of reading"
    text += f" and {event.peak_bytes / 1e9:.1f} GB of memory"
    if event.device_bytes:
        text += f", {event.device_bytes / 1e9:.1f} GB on the device"
    if event.photos_kept:
        return text
    return f"{text}; {size_text(event.photo_bytes)} of photos are cached, the others read again"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
