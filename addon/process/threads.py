"""Threads that are joined before the process ends; no bpy.

Daemon threads keep running during Python's shutdown. One that then returns from numpy or the
rasterizer is ended inside native code, which aborts the whole process.
"""

import atexit
import threading
import time
import weakref
from collections.abc import Callable

_PATIENCE = 10.0
"""Total wait for all threads at the end of the process, seconds."""

_started: "weakref.WeakKeyDictionary[threading.Thread, Callable[[], object]]" = (
    weakref.WeakKeyDictionary()
)


def start(
    target: Callable[[], object], name: str, *, cancel: Callable[[], object] = lambda: None
) -> threading.Thread:
    """Run a function in a new thread.

    Args:
        target: The function.
        name: Thread name.
        cancel: Called at the end of the process; must make the function return soon.
    """
    thread = threading.Thread(target=target, name=name, daemon=True)
    _started[thread] = cancel
    thread.start()
    return thread


@atexit.register
def finish() -> None:
    """Cancel all threads, and join them with a timeout."""
    running = [(thread, cancel) for thread, cancel in _started.items() if thread.is_alive()]
    for _, cancel in running:
        cancel()
    until = time.monotonic() + _PATIENCE
    for thread, _ in running:
        thread.join(max(until - time.monotonic(), 0.0))
