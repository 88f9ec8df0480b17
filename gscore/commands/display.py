"""How a command shows events: JSON lines for programs, one moving line for people, or nothing."""

import contextlib
import os
import sys
import time
from collections.abc import Callable
from typing import TextIO

from ..events import (
    DepthProgress,
    Estimated,
    Eval,
    Event,
    FrameStarted,
    Progress,
    Saved,
    Started,
    Warn,
    to_line,
)
from ..words import count_words, quality_words, size_words

_MASKS = {
    "ignore": "Masks are used: what they hide is not trained and not measured. --mask-mode none "
    "trains whole photos, composite the subject alone.",
    "composite": "Masks are used: they are the opacity of the subject, and nothing else is "
    "trained. --mask-mode none trains whole photos, ignore leaves open what masks hide.",
}
"""By `mask_mode`."""
_LINE_PERIOD = 10.0
"""Seconds between two lines where stderr is not a terminal."""


class Silent:
    """Shows nothing."""

    def __call__(self, event: Event) -> None:
        """Drop the event."""


class JsonLines:
    """Each event as a line of JSON."""

    def __init__(self, stream: TextIO, *, on_closed: Callable[[], None]) -> None:
        """Write to `stream`; `on_closed` is called once if nobody reads it any more."""
        self._stream = stream
        self._on_closed = on_closed
        self._open = True

    def __call__(self, event: Event) -> None:
        """Write the event at once."""
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
    """A line that moves on a terminal, and a line every few seconds elsewhere."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._moving = stream.isatty()
        self._width = 0
        self._last = -_LINE_PERIOD

    def __call__(self, event: Event) -> None:
        """Show the event."""
        match event:
            case Estimated():
                self._permanent(estimate_text(event))
            case Started():
                if event.step:
                    self._permanent(f"Going on from step {event.step} of {event.iterations}")
                self._permanent(
                    f"{count_words(event.train_views, 'training view')}, "
                    f"{count_words(event.test_views, 'test view')}, "
                    f"{event.width} x {event.height} px; {count_words(event.splats, 'splat')} to "
                    f"start with; {count_words(event.threads, 'thread')}, {event.isa}"
                )
                if sentence := _MASKS.get(event.mask_mode):
                    self._permanent(sentence)
                if event.depth:
                    self._permanent(event.depth)
            case FrameStarted():
                how = (
                    "complete already"
                    if event.complete
                    else f"{count_words(event.iterations, 'step')}"
                )
                how += ", from the frame before" if event.start and not event.complete else ""
                place = f"{event.place} of {event.frames}"
                self._permanent(f"Frame {event.frame} ({place}): {how}")
            case Progress():
                self._progress(progress_text(event), last=event.step >= event.iterations)
            case DepthProgress(done=done, total=total) if done:
                text = f"{done}/{total} {event.view}  {clock(event.eta_s)} left  {event.phase}"
                self._progress(text, last=done == total)
            case Warn():
                self._permanent(f"Warning: {event.message}")
            case Eval():
                if event.metrics.get("ssim") is not None:
                    worth = quality_words(event.metrics)
                    self._permanent(
                        f"Step {event.step}, {count_words(event.split, 'view')}: {worth}"
                    )
            case Saved():
                self._permanent(f"Saved {event.path}")

    def _progress(self, text: str, *, last: bool) -> None:
        now = time.monotonic()
        if not self._moving and now - self._last < _LINE_PERIOD and not last:
            return
        self._last = now
        if self._moving:
            self._stream.write("\r" + text.ljust(self._width))
            self._width = len(text)
            self._stream.flush()
        else:
            self._permanent(text)

    def _permanent(self, text: str) -> None:
        clear = "\r" + " " * self._width + "\r" if self._width else ""
        self._width = 0
        self._stream.write(clear + text + "\n")
        self._stream.flush()


def progress_text(event: Progress) -> str:
    """One line for people."""
    share = event.step / max(event.iterations, 1)
    parts = [f"step {event.step}/{event.iterations} {share:4.0%}"]
    if event.splats:
        parts += [
            f"loss {event.loss:.4f}",
            f"PSNR {event.psnr:5.2f}",
            f"{count_words(event.splats, 'splat')}",
        ]
        if event.steps_per_s:
            parts += [f"{event.steps_per_s:.1f} steps/s", f"{clock(event.eta_s)} left"]
    return "  ".join([*parts, event.phase])


def estimate_text(event: Estimated) -> str:
    """What a training will take, for people."""
    text = f"About {clock(event.seconds)} of training and {event.peak_bytes / 1e9:.1f} GB of memory"
    if event.photos_kept:
        return text
    return f"{text}; {size_words(event.photo_bytes)} of photos are kept, the others read again"


def clock(seconds: float) -> str:
    """1:02:03 or 2:03; a dash if it is not known."""
    if not 0 <= seconds < sys.maxsize:
        return "-"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"
