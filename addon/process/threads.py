"""Threads that are joined before the process ends; no bpy.

Python lets daemon threads run on during its shutdown. One that then returns from numpy or from the
rasterizer ends inside foreign code, which aborts the whole process.
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
    """Run a function in a thread of its own.

    Args:
        target: The function.
        name: Thread name.
        cancel: Called at the end of the process, to end the function soon.
    """
    thread = threading.Thread(target=target, name=name, daemon=True)
    _started[thread] = cancel
    thread.start()
    return thread


@atexit.register
def finish() -> None:
    """Cancel all threads, and join them with a timeout."""
    under_way = [(thread, cancel) for thread, cancel in _started.items() if thread.is_alive()]
    for _, cancel in under_way:
        cancel()
    until = time.monotonic() + _PATIENCE
    for thread, _ in under_way:
        thread.join(max(until - time.monotonic(), 0.0))
