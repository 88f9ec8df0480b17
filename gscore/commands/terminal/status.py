"""Status lines on a stream: permanent lines, and a progress line below them on a terminal.

Only carriage returns, spaces and ASCII are written, which every terminal and encoding supports. The
progress line never reaches the last column, so that it does not wrap. If the terminal becomes
narrower than the line, the wrapped part stays above: moving up could erase other lines.
"""

import os
import sys
import textwrap
import time
import unicodedata
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Self, TextIO

from ...events import seconds_left
from ...option_marks import show_flags

_LINE_PERIOD = 10.0
"""Seconds between two lines where the line cannot be redrawn."""
_DRAW_PERIOD = 0.1
"""Seconds between two updates of the progress line."""
_WIDEST = 100
"""Maximum columns of the progress line: wider ones are harder to read, and wrap when resized."""
_ECHO = 2
"""Columns of the ^C that a terminal echoes after the progress line."""
_USUAL = 80
"""Columns of a terminal of unknown width."""
_BAR = (10, 30)
"""Columns of the progress bar, at least and at most."""


class Status:
    """A progress line at the end of a terminal; elsewhere a line every few seconds."""

    def __init__(self, stream: TextIO, *, quiet: bool = False) -> None:
        """Write to `stream`; `quiet`: write nothing."""
        self._stream = stream
        self._quiet = quiet
        self._moving = can_move(stream)
        self._shown = 0
        # A log needs no lines on work of a few seconds.
        self._last = float("-inf") if self._moving else time.monotonic()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.clear()

    def print_line(self, text: str) -> None:
        """Write a line that stays."""
        if not self._quiet:
            self.clear()
            self._stream.write(wrapped(text, self._stream) + "\n")
            self._stream.flush()

    def show(
        self, parts: Sequence[str], *, share: float | None = None, immediate: bool = False
    ) -> None:
        """Show the progress, unless it was updated a moment ago.

        Args:
            parts: Texts, the most important first; the last ones are left out on narrow terminals.
            share: Completed share of the work, 0 to 1, drawn as a bar; None: not known.
            immediate: Update a terminal regardless of the last update; for the end.
        """
        now = time.monotonic()
        period = _DRAW_PERIOD if self._moving else _LINE_PERIOD
        is_due = now - self._last >= period or (immediate and self._moving)
        if self._quiet or not is_due:
            return
        self._last = now
        parts = [self._printable(part) for part in parts if part]
        if not self._moving:
            self._stream.write("  ".join([*_percent(share), *parts]) + "\n")
        else:
            width = max(min(_columns(self._stream), _WIDEST) - 1 - _ECHO, 1)
            text = line_within(parts, share, width)
            rest = max(min(self._shown, width) - cells(text), 0)
            self._stream.write("\r" + text + " " * rest)
            self._shown = cells(text)
        self._stream.flush()

    def clear(self) -> None:
        """Remove the progress line."""
        if self._shown:
            self._stream.write("\r" + " " * min(self._shown, _columns(self._stream) - 1) + "\r")
            self._stream.flush()
        self._shown = 0
        self._last = float("-inf") if self._moving else self._last

    def _printable(self, text: str) -> str:
        """The text as written by the stream, without characters that move the cursor."""
        encoding = self._stream.encoding or "ascii"
        known = text.encode(encoding, "backslashreplace").decode(encoding)
        return "".join("?" if unicodedata.category(c)[0] == "C" else c for c in known)


class Counted:
    """Progress of equal pieces of work on a `Status`, with the estimated remaining time."""

    def __init__(self, status: Status, total: int, what: str) -> None:
        """`what`: noun for one piece of work, such as "view"."""
        self._status, self._total, self._what = status, total, what
        self._began = time.monotonic()
        status.show([f"{what} 1 of {total}"], share=0.0)

    def __call__(self, done: int, *parts: str) -> None:
        """Show the number of finished pieces, followed by `parts`."""
        left = clock(seconds_left(self._began, done, self._total))
        head = [f"{left} left", f"{self._what} {done} of {self._total}"]
        last = done == self._total
        self._status.show([*head, *parts], share=done / self._total, immediate=last)


class Rows:
    """Prints each row of a table on stdout, and shows progress on the next one."""

    def __init__(self, status: Status, what: str, *, quiet: bool = False) -> None:
        """`what`: name of the work; `quiet`: print no rows."""
        self._status, self._what, self._quiet = status, what, quiet
        self._count = 0
        self._next()

    def __call__(self, row: str) -> None:
        """Print a row."""
        if not self._quiet:
            self._status.clear()
            sys.stdout.write(row + "\n")
            sys.stdout.flush()
        self._next()

    def _next(self) -> None:
        self._count += 1
        self._status.show([f"{self._what}, row {self._count}"], immediate=True)


@contextmanager
def show_while(stream: TextIO, words: str) -> Iterator[None]:
    """Show `words` on a terminal for the duration of a block, for instance of a slow import."""
    status = Status(stream, quiet=not can_move(stream))
    status.show([words])
    with status:
        yield


def wrapped(text: str, stream: TextIO) -> str:
    """The text wrapped between words to the width of a terminal; continuations of an indented line
    are indented two columns more; marked options become flags."""
    text = show_flags(text)
    if not stream.isatty():
        return text
    width = _columns(stream)
    return "\n".join(_broken(line, width) for line in text.split("\n"))


def print_warnings(sentences: Iterable[str]) -> None:
    """Each warning on stderr, wrapped."""
    for sentence in sentences:
        print(wrapped(f"Warning: {sentence}", sys.stderr), file=sys.stderr)


def _broken(line: str, width: int) -> str:
    if cells(line) <= width:
        return line
    depth = len(line) - len(line.lstrip())
    return textwrap.fill(
        line,
        width,
        subsequent_indent=" " * (depth + 2 if depth else 0),
        break_long_words=False,
        break_on_hyphens=False,
    )


def can_move(stream: TextIO) -> bool:
    """Whether the stream is a terminal that supports carriage returns."""
    return stream.isatty() and os.environ.get("TERM") != "dumb"


def line_within(parts: Sequence[str], share: float | None, width: int) -> str:
    """A bar, a percentage and the first parts that fit `width` columns.

    Args:
        parts: Texts without characters that move the cursor.
        share: Completed share of the work, 0 to 1; None: no bar.
        width: Columns, at least 1.

    Returns:
        A text of at most `width` columns.
    """
    texts, room = [*_percent(share), *parts], width
    if share is not None:
        room -= _BAR[0] + 2
    kept = 0
    while kept < len(texts) and _length(texts[: kept + 1]) <= room:
        kept += 1
    if not kept:
        return _cut(texts[0], width) if texts else ""
    if share is None:
        return "  ".join(texts[:kept])
    columns = min(_BAR[0] + room - _length(texts[:kept]), _BAR[1])
    return "  ".join([_bar(share, columns), *texts[:kept]])


def cells(text: str) -> int:
    """Columns of a text on a terminal: two for wide characters, none for combining ones."""
    return sum(
        0 if unicodedata.combining(c) else 2 if unicodedata.east_asian_width(c) in "WF" else 1
        for c in text
    )


def clock(seconds: float) -> str:
    """1:02:03 or 2:03; a dash if it is not known."""
    if not 0 <= seconds < float("inf"):
        return "-"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


def _percent(share: float | None) -> list[str]:
    return [] if share is None else [f"{int(100 * min(max(share, 0.0), 1.0)):3d}%"]


def _length(texts: Sequence[str]) -> int:
    return sum(cells(text) for text in texts) + 2 * (len(texts) - 1)


def _bar(share: float, columns: int) -> str:
    inner = columns - 2
    full = int(inner * min(max(share, 0.0), 1.0))
    return f"[{'#' * full}{'-' * (inner - full)}]"


def _cut(text: str, width: int) -> str:
    while cells(text) > width:
        text = text[:-1]
    return text


def _columns(stream: TextIO) -> int:
    """Current width of the terminal, columns."""
    try:
        found = os.get_terminal_size(stream.fileno()).columns
    except (OSError, ValueError):  # a test stream, or a closed one
        found = 0
    return max(found, 2) if found else _USUAL
