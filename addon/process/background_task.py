"""Background tasks: a function that runs in a thread and reports its progress, and a thread for the
latest of several requests; no bpy.

All threads are joined before the process ends. Daemon threads keep running during Python's
shutdown; one that then returns from numpy or the rasterizer is ended inside native code, which
aborts the whole process.
"""

import atexit
import threading
import time
import weakref
from collections import deque
from collections.abc import Callable
from typing import Any, Generic, TypeVar


class Cancelled(Exception):  # noqa: N818 - nothing went wrong
    """Raised inside a cancelled task."""


class BackgroundTask:
    """One call of a function in a thread; the owner polls the attributes.

    The function gets this object: it calls `report` and `check`, and must not touch bpy.
    """

    def __init__(self, function: Callable[["BackgroundTask"], Any]) -> None:
        """Start the thread."""
        self.lines: deque[str] = deque(maxlen=200)
        """Progress lines, the latest last."""
        self.result: Any = None
        self.problem = ""
        """Error message, one sentence."""
        self.error: Exception | None = None
        """The exception raised by the function."""
        self.cancelled = False
        self._function = function
        self._cancel = threading.Event()
        self._thread = start_thread(self._run, "gscore-task", cancel=self.cancel)

    @property
    def running(self) -> bool:
        """True while the task runs."""
        return self._thread.is_alive()

    @property
    def last_line(self) -> str:
        """The latest of `lines`."""
        return self.lines[-1] if self.lines else ""

    def report(self, line: str) -> None:
        """Report progress; called by the function."""
        self.lines.append(line)

    def check(self) -> None:
        """Cancellation point, called by the function.

        Raises:
            Cancelled: the owner cancelled the task.
        """
        if self._cancel.is_set():
            raise Cancelled

    def cancel(self) -> None:
        """Request cancellation."""
        self._cancel.set()

    def wait(self, timeout: float) -> bool:
        """Wait for the end; True if the task has ended."""
        self._thread.join(timeout)
        return not self.running

    def _run(self) -> None:
        try:
            self.result = self._function(self)
        except Cancelled as error:
            self.cancelled, self.problem, self.error = True, "Cancelled.", error
        except Exception as error:  # the panel shows any error
            self.problem, self.error = str(error) or type(error).__name__, error


_IDLE = 10.0
"""Seconds without requests after which a worker's thread ends."""
RequestT = TypeVar("RequestT")
AnswerT = TypeVar("AnswerT")


class Latest(Generic[RequestT, AnswerT]):
    """Worker for the newest request; requests that have not started are dropped."""

    def __init__(self, work: Callable[[RequestT], AnswerT], name: str) -> None:
        """Initialise; the thread starts at the first request.

        Args:
            work: Called in the thread. Its ValueError or MemoryError becomes `problem`.
            name: Thread name.
        """
        self._work, self._name = work, name
        self._changed = threading.Condition()
        self._request: RequestT | None = None
        self._thread: threading.Thread | None = None
        self._closed = False
        self.answer: tuple[RequestT, AnswerT] | None = None
        """The last answered request and its answer."""
        self.problem = ""
        """Error message of the last request."""
        self.fresh = False
        """True if an answer or an error arrived since the owner last set this to False."""
        self.busy = False
        """True while an answer is pending."""

    def submit(self, request: RequestT) -> None:
        """Request an answer; replaces a pending request."""
        with self._changed:
            if self._closed:
                return
            self._request, self.busy = request, True
            if self._thread is None:
                self._thread = start_thread(self._run, self._name, cancel=self.close)
            self._changed.notify()

    def take(self) -> AnswerT | None:
        """The answer since the last call, which is then released."""
        with self._changed:
            answer, self.answer = self.answer, None
        return None if answer is None else answer[1]

    def close(self) -> None:
        """End the thread after its current request."""
        with self._changed:
            self._closed, self._request = True, None
            self._changed.notify()

    def _run(self) -> None:
        while True:
            with self._changed:
                self.busy = self._request is not None
                self._changed.wait_for(lambda: self._request is not None or self._closed, _IDLE)
                if self._request is None:
                    self._thread = None
                    return
                request, self._request = self._request, None
            self._answer(request)

    def _answer(self, request: RequestT) -> None:
        try:
            answer, problem = (request, self._work(request)), ""
        except (ValueError, MemoryError) as error:
            answer, problem = None, str(error) or "Out of memory."
        with self._changed:
            self.answer, self.problem, self.fresh = answer, problem, True


_PATIENCE = 10.0
"""Total wait for all threads at the end of the process, seconds."""

_started: "weakref.WeakKeyDictionary[threading.Thread, Callable[[], object]]" = (
    weakref.WeakKeyDictionary()
)


def start_thread(
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
def join_threads() -> None:
    """Cancel all threads, and join them with a timeout."""
    running = [(thread, cancel) for thread, cancel in _started.items() if thread.is_alive()]
    for _, cancel in running:
        cancel()
    until = time.monotonic() + _PATIENCE
    for thread, _ in running:
        thread.join(max(until - time.monotonic(), 0.0))
