"""Signal guard: imports that cannot change the signal handlers of the process."""

import ctypes
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

_ROOM = 1024
"""Buffer for a `struct sigaction`, bytes; it has 152 on Linux and 16 on macOS."""
_lock = threading.Lock()


@contextmanager
def keep_signal_handlers() -> Iterator[None]:
    """Context after which all signal handlers are as before; usable from any thread.

    Imported libraries may replace handlers: pycolmap installs a crash handler that answers SIGTERM
    with a stack trace, so a terminated run would leave no checkpoint. Python's `signal.signal`
    works in the main thread only, so this calls the system's `sigaction`. On systems without it
    (Windows) this does nothing.
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
    """The raw `struct sigaction` of each signal that can be handled."""
    library, handlers = ctypes.CDLL(None), {}
    for number in sorted(signal.valid_signals() - {signal.SIGKILL, signal.SIGSTOP}):
        handler = ctypes.create_string_buffer(_ROOM)
        if library.sigaction(number, None, handler) == 0:
            handlers[int(number)] = handler
    return handlers
