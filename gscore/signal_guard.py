"""Signal guard: imports that cannot change the signal handlers of the process."""

import ctypes
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

_ROOM = 1024
"""Bytes of a `struct sigaction`, which is 152 on Linux and 16 on macOS, with room to spare."""
_lock = threading.Lock()


@contextmanager
def keep_signal_handlers() -> Iterator[None]:
    """A block after which every signal goes where it went before, from any thread.

    Libraries that are loaded may take signals over: pycolmap brings a crash handler that answers
    SIGTERM with a stack trace, so that a run which is asked to end leaves no checkpoint. Python's
    own `signal.signal` puts nothing back outside the main thread, so the system is asked. Where it
    knows no `sigaction` (Windows) this does nothing.
    """
    if os.name != "posix":
        yield
        return
    with _lock:
        before = _handlers()
        try:
            yield
        finally:
            library = ctypes.CDLL(None)
            for number, handler in before.items():
                library.sigaction(number, handler, None)


def _handlers() -> dict[int, Any]:
    """What the system does at each signal that can be handled, as it writes it."""
    library, found = ctypes.CDLL(None), {}
    for number in sorted(signal.valid_signals() - {signal.SIGKILL, signal.SIGSTOP}):
        handler = ctypes.create_string_buffer(_ROOM)
        if library.sigaction(number, None, handler) == 0:
            found[int(number)] = handler
    return found
