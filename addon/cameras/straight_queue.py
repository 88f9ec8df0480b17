"""Photos that are straightened by a program beside Blender, one after the other; no bpy."""

import json
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

from ..process.program import Process

ANSWER = "straightened "
"""Begins an answer of the program: a Blender says other things too."""
_BUDGET = 0.02
"""Seconds for reading answers at one beat."""


class StraightQueue:
    """Copies that are wanted; the program runs as long as there are any."""

    def __init__(self) -> None:
        """Nothing is wanted yet."""
        self.done = 0
        """Copies made since it was last idle."""
        self.problems: dict[str, str] = {}
        """Why copies could not be made, by their file."""
        self._tasks: dict[str, dict[str, Any]] = {}
        self._current = ""
        self._process: Process | None = None

    @property
    def busy(self) -> bool:
        """Whether something is wanted, or the program still ends."""
        return bool(self._tasks) or self._process is not None

    @property
    def total(self) -> int:
        """Copies that were wanted since it was last idle."""
        return self.done + len(self._tasks)

    def ask(self, task: dict[str, Any]) -> None:
        """Make this copy next, after the one that is being made."""
        if not self.busy:
            self.done = 0
        copy = task["copy"]
        self.problems.pop(copy, None)
        if copy != self._current:
            waiting = {key: other for key, other in self._tasks.items() if key != copy}
            first = {self._current: waiting.pop(self._current)} if self._current else {}
            self._tasks = {**first, copy: task, **waiting}

    def stop(self) -> None:
        """Forget what is wanted; the copy that is being made stays whole."""
        self._tasks = {copy: t for copy, t in self._tasks.items() if copy == self._current}

    def poll(self, program: Callable[[], tuple[list[str], Mapping[str, str]]]) -> list[str]:
        """Take in what the program has told, and hand it the next task; the copies that were made.

        Args:
            program: Arguments and variables of the program, where it has to be started.
        """
        if not self.busy:
            return []
        if self._process is None:
            try:
                arguments, variables = program()
                self._process = Process(arguments, variables=MappingProxyType(dict(variables)))
            except OSError as error:
                self._give_up(f"Blender cannot be started once more: {error}.")
                return []
        made = [copy for line in self._process.lines(_BUDGET) if (copy := self._answer(line))]
        if self._process.ended:
            self._ended(self._process)
        elif not self._current:
            self._next(self._process)
        return made

    def kill(self) -> None:
        """End the program at once, and forget what is wanted."""
        if self._process is not None:
            self._process.kill(wait=5.0)
        self._tasks, self._current, self._process = {}, "", None

    def _next(self, process: Process) -> None:
        self._current = next(iter(self._tasks), "")
        if self._current:
            process.send(json.dumps(self._tasks[self._current]))
        else:
            process.end_input()

    def _answer(self, line: str) -> str:
        """The copy that was made, if the line says so."""
        if not line.startswith(ANSWER):
            return ""
        told = json.loads(line.removeprefix(ANSWER))
        copy, problem = str(told["copy"]), str(told["problem"])
        self._tasks.pop(copy, None)
        self._current = ""
        if problem:
            self.problems[copy] = problem
            return ""
        self.done += 1
        return copy

    def _ended(self, process: Process) -> None:
        """Where it ended in the middle of a photo, that one is left out."""
        if self._current:
            last = next((line for line in reversed(process.stderr_tail) if line.strip()), "")
            self.problems[self._current] = (
                f"The Blender that straightens photos ended by itself at {self._current} "
                f"(exit code {process.returncode}). {last}"
            )
            self._tasks.pop(self._current, None)
        self._current, self._process = "", None

    def _give_up(self, problem: str) -> None:
        self.problems.update(dict.fromkeys(self._tasks, problem))
        self._tasks = {}
