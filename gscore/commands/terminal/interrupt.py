"""Interrupts of a command: signals, and standard streams that are missing or get closed.

The first requests an orderly stop. A later Ctrl-C exits immediately; other later signals are
ignored, since systems send several for one event: SIGHUP when a terminal closes, SIGTERM by
`timeout`.
"""

import contextlib
import errno
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any, Self, TextIO

from ...ending_signals import ending_signals
from ...io.files import reason

_SIGPIPE = 13
"""POSIX number; the exit code is the same on systems without the signal."""
PIPE_CLOSED = 128 + _SIGPIPE
"""Exit code after the reader of the output closed it."""
HUNG_UP = 129
"""Exit code after the terminal closed: 128 + SIGHUP."""
_current: "Interrupt | None" = None


class Interrupt:
    """Context manager that handles signals and forwards the first one to the command.

    Within `stopped_by`, the stop callback is called. Within `working`, a KeyboardInterrupt is
    raised. Before both, the process exits immediately, because nothing is open; after them there
    is nothing to stop.
    """

    def __init__(self) -> None:
        self._before: dict[int, Any] = {}
        self._hook = sys.unraisablehook
        self._received = 0
        self._output_code = 0
        self._stop: Callable[[str], None] | None = None
        self._quiet = False
        self._begun = self._over = False
        self.raised = False
        """Whether KeyboardInterrupt was raised; errors caused by it are not reported."""

    @property
    def exit_code(self) -> int:
        """128 + the received signal, as in shells, or the code given to `output_lost`; 0 if
        neither."""
        return 128 + self._received if self._received else self._output_code

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number in ending_signals():
                self._before[number] = signal.signal(number, self._handle)
            if hasattr(signal, "SIGPIPE"):
                self._before[_SIGPIPE] = signal.signal(signal.SIGPIPE, self._pipe_closed)
            sys.unraisablehook = self._unraisable
        return self

    def __exit__(self, *_: object) -> None:
        if self._before:
            sys.unraisablehook = self._hook
        for number, handler in self._before.items():
            signal.signal(number, handler)

    @contextmanager
    def working(self) -> Iterator[None]:
        """Context of work that a KeyboardInterrupt may end anywhere."""
        self._begun = True
        try:
            yield
        finally:
            self._over = True

    @contextmanager
    def stopped_by(self, stop: Callable[[str], None], *, quiet: bool) -> Iterator[None]:
        """Context of work that ends by itself after `stop(reason)`; `quiet`: no message."""
        self._stop, self._quiet, self._over = stop, quiet, False
        if self.exit_code:
            stop("interrupted" if self._received else "output closed")
        try:
            yield
        finally:
            self._stop, self._over = None, True

    def output_lost(self, code: int) -> None:
        """Stop because the output was closed, with exit code `code`. One of several ranks continues
        instead, because torchrun would restart it after the others have finished."""
        if one_of_many() and code in (PIPE_CLOSED, HUNG_UP):
            return
        self._output_code = self._output_code or code
        if self._stop is not None:
            self._stop("output closed")

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self._received:
            if number == signal.SIGINT and not self._over:
                self._leave("Stopped immediately. Files written before are complete.")
            return
        self._received = number
        if self._stop is not None:
            self._stop("interrupted")
            self._print("Stopping in an orderly way; press Ctrl-C again to stop immediately.")
        elif not self._begun:
            self._leave("Stopped.")
        elif not self._over:
            self.raised = True
            raise KeyboardInterrupt

    def _pipe_closed(self, number: int, frame: FrameType | None) -> None:
        self.output_lost(PIPE_CLOSED)

    def _leave(self, sentence: str) -> None:
        self._print(sentence)
        os._exit(self.exit_code)

    def _print(self, sentence: str) -> None:
        """Write to stderr without Python's streams, which the signal may have interrupted."""
        if self._quiet:
            return
        with contextlib.suppress(OSError):
            start = "\n" if os.isatty(2) else ""
            os.write(2, f"{start}{sentence}\n".encode())

    def _unraisable(self, problem: Any) -> None:
        """Suppress Python's message on a KeyboardInterrupt in a destructor or callback."""
        if not self.raised:
            self._hook(problem)


@contextmanager
def interrupts() -> Iterator[Interrupt]:
    """Context with the instance of this process, created if there is none."""
    global _current
    if _current is not None:
        yield _current
        return
    with Interrupt() as made:
        _current = made
        try:
            yield made
        finally:
            _current = None


def under_torchrun() -> bool:
    """Whether torchrun, or a launcher with its environment variables, started this process."""
    return {"RANK", "WORLD_SIZE"} <= os.environ.keys()


def is_worker() -> bool:
    """Whether another process, rank 0, writes the output of the command."""
    return under_torchrun() and os.environ["RANK"] != "0"


def one_of_many() -> bool:
    """Whether it started other processes too."""
    return under_torchrun() and os.environ["WORLD_SIZE"] not in ("0", "1")


_CANNOT_WRITE = 2
_NAMES = ("stdin", "stdout", "stderr")
_COMMANDS = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]")
"""Control characters except tab, line feed and carriage return."""


class SafeStream:
    """A text stream whose writes never fail: text that cannot be written is dropped.

    The first failure is reported, and the stream then writes to the null device, so that Python
    does not fail again when it flushes at exit.
    """

    def __init__(self, stream: TextIO, on_lost: Callable[[OSError], None]) -> None:
        self._stream = stream
        self._on_lost = on_lost
        self._open = True

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write like a text stream; unencodable characters are escaped."""
        self._try(lambda: self._stream.write(self._printable(text)))
        return len(text)

    def flush(self) -> None:
        """Flush like a text stream."""
        self._try(self._stream.flush)

    def _printable(self, text: str) -> str:
        """The text with escapes for unencodable characters and terminal commands, since names in
        captures and files may contain anything."""
        text = _COMMANDS.sub(lambda found: f"\\x{ord(found[0]):02x}", text)
        encoding = getattr(self._stream, "encoding", None) or "utf-8"
        try:
            text.encode(encoding)
        except UnicodeEncodeError:
            return text.encode(encoding, "backslashreplace").decode(encoding)
        return text

    def _try(self, act: Callable[[], object]) -> None:
        if not self._open:
            return
        try:
            act()
        except OSError as error:
            self._open = False
            with contextlib.suppress(OSError, ValueError):
                _to_null(self._stream.fileno())
            self._on_lost(error)


@contextmanager
def safe_streams(on_lost: Callable[[int], None]) -> Iterator[None]:
    """Context in which all three streams exist, and stdout and stderr are `SafeStream`.

    Args:
        on_lost: Called with an exit code when writing to a stream fails.
    """

    def lost(error: OSError) -> None:
        if error.errno in (errno.EPIPE, errno.EINVAL):  # the second is Windows'
            on_lost(PIPE_CLOSED)
        elif error.errno == errno.EIO:
            on_lost(HUNG_UP)
        else:
            on_lost(_CANNOT_WRITE)
            print(f"gscore: error: Cannot write the output: {reason(error)}", file=sys.stderr)

    for descriptor, name in enumerate(_NAMES):
        if getattr(sys, name) is None:
            setattr(sys, name, _opened(descriptor))
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (SafeStream(stream, lost) for stream in before)  # type: ignore[assignment]
    try:
        yield
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        sys.stdout, sys.stderr = before


def _opened(descriptor: int) -> TextIO:
    """A replacement for a stream that was closed from the start.

    Its descriptor must be taken too: else the next opened file would get it, along with the output
    of libraries.
    """
    mode = "r" if descriptor == 0 else "w"
    with contextlib.suppress(OSError):
        os.fstat(descriptor)
        return Path(os.devnull).open(mode, encoding="utf-8")  # the descriptor is in use already
    _to_null(descriptor)
    return os.fdopen(descriptor, mode, encoding="utf-8", closefd=False)


def _to_null(descriptor: int) -> None:
    null = os.open(os.devnull, os.O_RDWR)
    if null != descriptor:
        os.dup2(null, descriptor)
        os.close(null)
