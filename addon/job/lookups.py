"""What panels show of folders on a disk, found in threads and kept; no bpy."""

import time
from collections.abc import Callable, Hashable
from pathlib import Path
from typing import Generic, TypeVar

from ..capture.depth_maps import DepthReport, read_run_report
from ..capture.inspection import CaptureFacts, inspect
from ..core import Estimate
from ..process.background import Task
from . import earlier, forecast

KeyT = TypeVar("KeyT", bound=Hashable)
AnswerT = TypeVar("AnswerT")


class Lookup(Generic[KeyT, AnswerT]):
    """Answers of one function; panels ask for them while they draw, and must not wait."""

    def __init__(self, function: Callable[[KeyT], AnswerT], *, max_age: float) -> None:
        """Keep what `function` finds.

        Args:
            function: Called in a thread; what it raises is its answer's problem.
            max_age: Seconds after which an answer is looked up again when it is asked for.
        """
        self._function = function
        self._max_age = max_age
        self._answers: dict[KeyT, tuple[AnswerT | None, str, float]] = {}
        self._tasks: dict[KeyT, Task] = {}

    def get(self, key: KeyT) -> tuple[AnswerT | None, str]:
        """What is known by now: (answer, ""), (None, problem) or, still unknown, (None, "")."""
        self.collect()
        known = self._answers.get(key)
        stale = known is None or time.monotonic() - known[2] > self._max_age
        if stale and key not in self._tasks:
            self._tasks[key] = Task(lambda task: self._function(key))
        return (None, "") if known is None else known[:2]

    def wait(self, key: KeyT, timeout: float = 60.0) -> tuple[AnswerT | None, str]:
        """As `get`, after the end of the search; for scripts."""
        self.forget(key)
        self.get(key)
        if task := self._tasks.get(key):
            task.wait(timeout)
        return self.get(key)

    def forget(self, key: KeyT) -> None:
        """Look anew when it is asked for next."""
        self.collect()
        self._answers.pop(key, None)

    def expire(self) -> None:
        """Look anew for everything that is asked for next; what is known is shown meanwhile."""
        self.collect()
        self._answers = {key: (*known[:2], float("-inf")) for key, known in self._answers.items()}

    def collect(self) -> bool:
        """Take in what threads have found; whether that was anything new."""
        changed = False
        for key, task in list(self._tasks.items()):
            if task.running:
                continue
            answer = (task.result, task.problem, time.monotonic())
            changed |= answer[:2] != self._answers.get(key, (None, "", 0.0))[:2]
            self._answers[key] = answer
            del self._tasks[key]
        return changed

    @property
    def busy(self) -> bool:
        """Whether something is being looked up."""
        return bool(self._tasks)


captures: Lookup[tuple[str, str], CaptureFacts] = Lookup(
    lambda key: inspect(key[0], images=key[1]), max_age=600.0
)
"""What a capture holds, by its path and the name of its photo folder."""
runs: Lookup[tuple[Path, Path | None], earlier.EarlierRun | None] = Lookup(
    lambda key: earlier.look(*key), max_age=3.0
)
"""What an output folder holds already, by its path and the chosen capture's."""
depth_runs: Lookup[Path, DepthReport | None] = Lookup(read_run_report, max_age=10.0)
"""What became of the depth maps in the training in an output folder."""
forecasts: Lookup[forecast.Question, Estimate] = Lookup(forecast.answer, max_age=20.0)
"""What a training would take."""
_ALL = (captures, runs, depth_runs, forecasts)


def collect() -> bool:
    """Take in what was found; whether that was anything new."""
    return sum(found.collect() for found in _ALL) > 0  # any() would stop at the first


def busy() -> bool:
    """Whether something is being looked up."""
    return any(found.busy for found in _ALL)
