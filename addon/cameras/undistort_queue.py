"""Undistortion queue: photos processed one after the other by a child process; no bpy."""

import json
from collections.abc import Callable, Iterable, Mapping
from types import MappingProxyType
from typing import Any

from ..process.child_program import Process

READY = "ready to undistort"
"""First line of the program, among other output of Blender."""
ANSWER = "undistorted "
"""Prefix of the program's answers."""
_STARTS = 2
"""Largest number of starts of a program that never becomes ready."""
_BUDGET = 0.02
"""Seconds for reading answers per poll."""


class UndistortQueue:
    """Queue of requested copies; the program runs while there are any."""

    def __init__(self) -> None:
        """Initialise an empty queue."""
        self.done = 0
        """Copies written since the queue was last idle."""
        self.problems: dict[str, str] = {}
        """Errors by file of the copy."""
        self._tasks: dict[str, dict[str, Any]] = {}
        self._current = ""
        self._process: Process | None = None
        self._closing = False
        """True after the end of the program's input."""
        self._starts = 0
        """Starts of the program since it was last ready."""

    @property
    def busy(self) -> bool:
        """True while copies are queued or the program is ending."""
        return bool(self._tasks) or self._process is not None

    @property
    def total(self) -> int:
        """Copies requested since the queue was last idle."""
        return self.done + len(self._tasks)

    def enqueue_first(self, tasks: Iterable[dict[str, Any]]) -> None:
        """Queue these copies first, after the current one."""
        if not self.busy:
            self.done = 0
        requested = {task["copy"]: task for task in tasks}
        for copy in requested:
            self.problems.pop(copy, None)
        current = {copy: t for copy, t in self._tasks.items() if copy == self._current}
        self._tasks = {**current, **requested, **self._tasks}

    def stop(self) -> None:
        """Clear the queue; the current copy is completed."""
        self._tasks = {copy: t for copy, t in self._tasks.items() if copy == self._current}

    def poll(self, program: Callable[[], tuple[list[str], Mapping[str, str]]]) -> list[str]:
        """Read the program's answers, and send it the next task; returns the written copies.

        Args:
            program: Arguments and variables for starting the program.
        """
        if not self.busy:
            return []
        if self._process is None and not self._start(program):
            return []
        process = self._process
        made = [copy for line in process.lines(_BUDGET) if (copy := self._answer(line))]
        if process.ended:
            self._ended(process)
        elif not self._current and not self._closing:
            self._next(process)
        return made

    def kill(self) -> None:
        """Kill the program, and clear the queue."""
        if self._process is not None:
            self._process.kill(wait=5.0)
        self._tasks, self._starts = {}, 0
        self._forget_process()

    def _start(self, program: Callable[[], tuple[list[str], Mapping[str, str]]]) -> bool:
        """Start the program; True if it runs."""
        try:
            arguments, variables = program()
            self._process = Process(arguments, variables=MappingProxyType(dict(variables)))
        except OSError as error:
            self._give_up(f"A second Blender cannot be started: {error}.")
            return False
        self._starts += 1
        return True

    def _next(self, process: Process) -> None:
        self._current = next(iter(self._tasks), "")
        if self._current:
            process.send(json.dumps(self._tasks[self._current]))
        else:
            self._closing = True
            process.end_input()

    def _answer(self, line: str) -> str:
        """File of the written copy, if the line reports one."""
        if line.startswith((READY, ANSWER)):
            self._starts = 0
        if not line.startswith(ANSWER):
            return ""
        answer = json.loads(line.removeprefix(ANSWER))
        copy, problem = str(answer["copy"]), str(answer["problem"])
        self._tasks.pop(copy, None)
        self._current = ""
        if problem:
            self.problems[copy] = problem
            return ""
        self.done += 1
        return copy

    def _ended(self, process: Process) -> None:
        """Drop the photo at which the program ended; start it again if it was never ready."""
        last = next((line for line in reversed(process.stderr_tail) if line.strip()), "")
        how = f"(exit code {process.returncode}). {last}".rstrip()
        if self._starts >= _STARTS:
            self._give_up(f"The Blender that undistorts photos ended at its start {how}")
        elif self._current and not self._starts:
            self._tasks.pop(self._current, None)
            self.problems[self._current] = (
                f"The Blender that undistorts photos ended unexpectedly at {self._current} {how}"
            )
        self._forget_process()

    def _forget_process(self) -> None:
        self._current, self._process, self._closing = "", None, False

    def _give_up(self, problem: str) -> None:
        self.problems.update(dict.fromkeys(self._tasks, problem))
        self._tasks, self._starts = {}, 0
