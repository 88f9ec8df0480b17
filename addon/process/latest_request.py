"""Latest-request worker: a thread that works on the newest request and drops older ones; no bpy."""

import threading
from collections.abc import Callable
from typing import Generic, TypeVar

from . import threads

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
                self._thread = threads.start(self._run, self._name, cancel=self.close)
            self._changed.notify()

    def close(self) -> None:
        """End the thread after its current request."""
        with self._changed:
            self._closed, self._request = True, None
            self._changed.notify()

    def _run(self) -> None:
        while True:
            with self._changed:
                self.busy = self._request is not None
                while self._request is None and not self._closed:
                    self._changed.wait()
                if self._closed:
                    return
                request, self._request = self._request, None
            try:
                self.answer, self.problem = (request, self._work(request)), ""
            except (ValueError, MemoryError) as error:
                self.answer, self.problem = None, str(error) or "Out of memory."
            self.fresh = True
