"""Background task: a function that runs in a thread and reports its progress; no bpy."""

import threading
from collections import deque
from collections.abc import Callable
from typing import Any

from . import threads


class Cancelled(Exception):  # noqa: N818 - nothing went wrong
    """Raised inside a task that was asked to end."""


class BackgroundTask:
    """One call of a function in a thread; the owner looks at the attributes when it suits.

    The function gets this object: it calls `tell` and `check`, and must not touch bpy.
    """

    def __init__(self, function: Callable[["BackgroundTask"], Any]) -> None:
        """Start it."""
        self.lines: deque[str] = deque(maxlen=200)
        """What it told, the latest last."""
        self.result: Any = None
        self.problem = ""
        """Why it failed, a sentence."""
        self.error: Exception | None = None
        """What it raised."""
        self.cancelled = False
        self._function = function
        self._cancel = threading.Event()
        self._thread = threads.start(self._run, "gscore-task", cancel=self.cancel)

    @property
    def running(self) -> bool:
        """Whether it is still under way."""
        return self._thread.is_alive()

    @property
    def last_line(self) -> str:
        """The latest of `lines`."""
        return self.lines[-1] if self.lines else ""

    def tell(self, line: str) -> None:
        """Called by the function: something to show."""
        self.lines.append(line)

    def check(self) -> None:
        """Called by the function where it may end.

        Raises:
            Cancelled: the owner asked for it.
        """
        if self._cancel.is_set():
            raise Cancelled

    def cancel(self) -> None:
        """Ask it to end soon."""
        self._cancel.set()

    def wait(self, timeout: float) -> bool:
        """Wait for the end; whether it has come."""
        self._thread.join(timeout)
        return not self.running

    def _run(self) -> None:
        try:
            self.result = self._function(self)
        except Cancelled as error:
            self.cancelled, self.problem, self.error = True, "Cancelled.", error
        except Exception as error:  # whatever it is, the panel has to show it
            self.problem, self.error = str(error) or type(error).__name__, error
