"""Incremental tasks: generators with steps on the calling thread, and parallel work; their pace in
a timer, and postponed garbage collection while they make many objects; no bpy.
"""

import gc
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
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


_NEVER = 2**31 - 1
_before: list[int] = []
"""Previous threshold of the full collection, one entry per task that postpones it."""


@contextmanager
def defer_collections() -> Iterator[None]:
    """Disable full garbage collections; collections of younger objects continue.

    After many allocations Python scans all objects, including those of Blender and other add-ons,
    and blocks every thread: 45 to 100 ms while thousands of cameras are read. Most objects of such
    work are freed at its end without a scan.
    """
    young, middle, old = gc.get_threshold()
    if not _before:
        gc.set_threshold(young, middle, _NEVER)
    _before.append(_before[0] if _before else old)
    try:
        yield
    finally:
        before = _before.pop()
        young, middle, old = gc.get_threshold()
        if not _before and old == _NEVER:  # else other code has set another threshold
            gc.set_threshold(young, middle, before)


FAST = 0.05
"""Lateness of a call up to which redraws count as fast, seconds."""
SHARE = 0.25
"""Share of further lateness for work beyond one step."""
LONGEST = 0.1
"""Upper limit of that work, seconds."""
_IDLE = 5e-4
"""Longest duration of a step without work, seconds."""


class Pace:
    """Time budget of a timer's calls.

    Blender calls timers between redraws: with one step per call, a hundred steps take a hundred
    redraws. The lateness of a call measures the duration of a redraw.
    """

    def __init__(self) -> None:
        """Initialise; the first call is never late."""
        self._due = float("inf")
        self._until = self._began = 0.0
        self.spare = 0.0
        """Seconds of this call beyond one step; 0 if redraws are fast."""

    def begin(self) -> None:
        """Note the start of a call."""
        self._began = time.monotonic()
        self.spare = min(SHARE * max(self._began - self._due - FAST, 0.0), LONGEST)
        self._until = self._began + self.spare

    def more(self, *, did: bool = False) -> bool:
        """True if this call has time for another step; call after each step.

        Args:
            did: True if the last step did any work, however short.
        """
        began, self._began = self._began, time.monotonic()
        return self._began < self._until and (did or self._began - began > _IDLE)

    def end(self, interval: float | None) -> None:
        """Note the end of a call and the delay of the next one, seconds; None: any."""
        if interval is None:
            self._due, self.spare = float("inf"), 0.0
        else:
            self._due = time.monotonic() + interval
