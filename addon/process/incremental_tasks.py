"""Incremental tasks: generators with steps on the calling thread, and parallel work; no bpy."""

from collections.abc import Callable, Generator
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from .background_task import BackgroundTask

ResultT = TypeVar("ResultT")
BUDGET = 0.008
"""Seconds of a step in which new work starts; the last item may double that."""
Check = Callable[[], None]
"""Raises if the work was cancelled."""


@dataclass(frozen=True)
class ThreadCall:
    """Request of a generator to call a function in a thread."""

    function: Callable[[Check], Any]
    sentence: str
    """Progress sentence meanwhile."""


Steps = Generator[str | ThreadCall, Any, ResultT]
"""Generator that yields a progress sentence after each step and returns the result.

A step on Blender's main thread takes at most some hundredths of a second; longer calls go to
`run_in_thread`. Cleanup after cancellation belongs in `finally`.
"""


def run_in_thread(function: Callable[[Check], ResultT], sentence: str) -> Steps[ResultT]:
    """Call a function in a thread; its result or exception is returned or raised here.

    Args:
        function: Must not touch bpy. Its argument raises after cancellation.
        sentence: Progress sentence meanwhile.
    """
    return (yield ThreadCall(function, sentence))


class TaskRunner:
    """Runs a generator one step per call of `step`."""

    def __init__(self, steps: Steps[Any]) -> None:
        """Initialise without running a step."""
        self.sentence = ""
        """Progress sentence."""
        self.result: Any = None
        """Result of the finished work."""
        self._steps = steps
        self._task: BackgroundTask | None = None

    @property
    def waits(self) -> bool:
        """True while a thread runs, so that the next step does nothing."""
        return self._task is not None and self._task.running

    def step(self) -> bool:
        """Run the next step, unless it `waits`; True if all is done.

        Raises:
            Any exception of the work, which ends it.
        """
        if self.waits:
            return False
        task, self._task = self._task, None
        try:
            if task is None:
                request = next(self._steps)
            elif task.error is not None:
                request = self._steps.throw(task.error)
            else:
                request = self._steps.send(task.result)
        except StopIteration as end:
            self.result = end.value
            return True
        if isinstance(request, ThreadCall):
            self.sentence, function = request.sentence, request.function
            self._task = BackgroundTask(lambda task: function(task.check))
        else:
            self.sentence = request
        return False

    def cancel(self) -> None:
        """Cancel the work."""
        if self._task is not None:
            self._task.cancel()
        self._steps.close()


def run_blocking(steps: Steps[ResultT]) -> ResultT:
    """Run all steps synchronously, without a thread."""
    go_on: Callable[[], str | ThreadCall] = partial(next, steps)
    try:
        while True:
            request = go_on()
            waits = isinstance(request, ThreadCall)
            go_on = _answered(steps, request) if waits else partial(next, steps)
    except StopIteration as end:
        return end.value


def _answered(steps: Steps[Any], request: ThreadCall) -> Callable[[], str | ThreadCall]:
    """Continuation of the work with the result of a function called on this thread."""
    try:
        return partial(steps.send, request.function(lambda: None))
    except Exception as error:
        return partial(steps.throw, error)
