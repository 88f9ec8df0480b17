"""Lookup cache: results computed in threads, for panels that must not block; no bpy."""

import time
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

from ..process.background_task import BackgroundTask
from .option_labels import error_text

KeyT = TypeVar("KeyT", bound=Hashable)
AnswerT = TypeVar("AnswerT")


class Lookup(Generic[KeyT, AnswerT]):
    """Cached results of one function, for panels that must not block while they draw."""

    def __init__(self, function: Callable[[KeyT], AnswerT], *, max_age: float) -> None:
        """Cache results of `function`.

        Args:
            function: Called in a thread; its exception becomes the problem, with panel labels.
            max_age: Seconds after which a request computes the answer again.
        """
        self._function = function
        self._max_age = max_age
        self._answers: dict[KeyT, tuple[AnswerT | None, str, float]] = {}
        self._tasks: dict[KeyT, BackgroundTask] = {}

    def get(self, key: KeyT) -> tuple[AnswerT | None, str]:
        """Cached result: (answer, ""), (None, problem) or, while pending, (None, "")."""
        self.collect()
        known = self._answers.get(key)
        stale = known is None or time.monotonic() - known[2] > self._max_age
        if stale and key not in self._tasks:
            self._tasks[key] = BackgroundTask(lambda task: self._function(key))
        return (None, "") if known is None else known[:2]

    def wait(self, key: KeyT, timeout: float = 60.0) -> tuple[AnswerT | None, str]:
        """Like `get`, after the function has returned; for scripts."""
        self.forget(key)
        self.get(key)
        if task := self._tasks.get(key):
            task.wait(timeout)
        return self.get(key)

    def forget(self, key: KeyT) -> None:
        """Drop a result, so that the next request computes it again."""
        self.collect()
        self._answers.pop(key, None)

    def expire(self) -> None:
        """Mark all results as stale; they are still returned until computed again."""
        self.collect()
        self._answers = {key: (*known[:2], float("-inf")) for key, known in self._answers.items()}

    def collect(self) -> bool:
        """Collect results of threads; True if any is new."""
        changed = False
        for key, task in list(self._tasks.items()):
            if task.running:
                continue
            problem = error_text(task.error) or task.problem
            answer = (task.result, problem, time.monotonic())
            changed |= answer[:2] != self._answers.get(key, (None, "", 0.0))[:2]
            self._answers[key] = answer
            del self._tasks[key]
        return changed

    @property
    def busy(self) -> bool:
        """True while a thread runs."""
        return bool(self._tasks)
