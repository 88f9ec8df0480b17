"""Standard streams of a command: always present, and writes never fail."""

import contextlib
import errno
import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

from ...io.files import reason
from .interrupt import HUNG_UP, PIPE_CLOSED

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
def safe_streams(prog: str, on_lost: Callable[[int], None]) -> Iterator[None]:
    """Context in which all three streams exist, and stdout and stderr are `SafeStream`.

    Args:
        prog: Name of the program, for messages.
        on_lost: Called with an exit code when writing to a stream fails.
    """

    def lost(error: OSError) -> None:
        if error.errno in (errno.EPIPE, errno.EINVAL):  # the second is Windows'
            on_lost(PIPE_CLOSED)
        elif error.errno == errno.EIO:
            on_lost(HUNG_UP)
        else:
            on_lost(_CANNOT_WRITE)
            print(f"{prog}: error: Cannot write the output: {reason(error)}", file=sys.stderr)

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
