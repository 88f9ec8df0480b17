"""Child program: a background process whose output lines are read without blocking; no bpy.

Threads read the pipes and fill queues; the owner of the object drains them.
"""

import contextlib
import math
import os
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from queue import Empty, SimpleQueue
from types import MappingProxyType
from typing import BinaryIO

_LONGEST_LINE = 1 << 20
"""Bytes; longer lines are not events and are dropped."""
_MOST_WAITING = 100_000
"""Lines kept until the owner reads them; further ones are dropped."""
_STDERR_KEPT = 60
_NICENESS = 5
"""Priority below Blender's, so that drawing precedes training on few cores."""
_PERIOD = 0.05
"""Seconds between two looks at a program that is waited for."""
_ORPHANED_PIPE = 2.0
"""Seconds to wait after the end for a pipe that another process keeps open."""


def environment(base: Mapping[str, str] | None = None) -> dict[str, str]:
    """Environment variables for a Python other than Blender's.

    Drops the variables that direct Blender's Python to its own files; disables imports from the
    current folder; output is UTF-8 and unbuffered.
    """
    base = os.environ if base is None else base
    dropped = ("PYTHON", "__PYVENV_LAUNCHER__")
    kept = {key: value for key, value in base.items() if not key.upper().startswith(dropped)}
    return kept | {"PYTHONSAFEPATH": "1", "PYTHONUNBUFFERED": "1", "PYTHONUTF8": "1"}


class Process:
    """A program in its own session, so that a Ctrl-C for Blender does not reach it."""

    def __init__(
        self, arguments: Sequence[str], *, variables: Mapping[str, str] = MappingProxyType({})
    ) -> None:
        """Start the program.

        Args:
            arguments: Program and arguments, never a shell command line.
            variables: Additional environment variables.

        Raises:
            OSError: the program is missing or cannot be run.
        """
        self.arguments = tuple(str(argument) for argument in arguments)
        self._process = subprocess.Popen(
            self.arguments,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={**environment(), **variables},
            **_own_session(),
        )
        if sys.platform != "win32":
            with contextlib.suppress(OSError):  # before it starts threads, which inherit this
                os.setpriority(os.PRIO_PGRP, self._process.pid, _NICENESS)
        self._lines: SimpleQueue[str | None] = SimpleQueue()
        self._errors: deque[str] = deque(maxlen=_STDERR_KEPT)
        self._orders: SimpleQueue[bytes | None] = SimpleQueue()
        self._output_ended = self._errors_ended = False
        self._ended_at: float | None = None
        self.last_line_at = time.monotonic()
        """`time.monotonic()` of the last output, or of the start."""
        for target in (self._read_output, self._read_errors, self._write_orders):
            threading.Thread(target=target, name="gscore-pipe", daemon=True).start()

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def returncode(self) -> int | None:
        """Exit code, negative for a signal; None while it runs."""
        code = self._process.poll()
        if code is not None and self._ended_at is None:
            self._ended_at = time.monotonic()
        return code

    @property
    def stderr_tail(self) -> list[str]:
        """The last lines of the error output."""
        return list(self._errors)

    def lines(self, budget: float) -> Iterator[str]:
        """Unread lines of the output, for at most `budget` seconds."""
        until = time.perf_counter() + budget
        while True:
            try:
                line = self._lines.get_nowait()
            except Empty:
                return
            if line is None:
                self._output_ended = True
                return
            yield line
            if time.perf_counter() > until:
                return

    @property
    def ended(self) -> bool:
        """True after the process has ended, its errors are read and `lines` gave all output."""
        if self.returncode is None or self._ended_at is None:
            return False
        # A child of it may keep the pipe open for longer.
        orphaned = time.monotonic() - self._ended_at > _ORPHANED_PIPE and self._lines.empty()
        return (self._output_ended and self._errors_ended) or orphaned

    def output(
        self,
        check: Callable[[], object] = lambda: None,
        report: Callable[[str], object] = lambda line: None,
        timeout: float = math.inf,
    ) -> list[str]:
        """Wait for its end in a thread; all lines of the output.

        Args:
            check: Called all the time; may raise, which kills the program.
            report: Called with each line.
            timeout: Seconds after which the program is killed.

        Raises:
            TimeoutError: it did not end in time.
        """
        until, found = time.monotonic() + timeout, []
        try:
            while not self.ended:
                check()
                for line in self.lines(_PERIOD):
                    found.append(line)
                    report(line)
                if time.monotonic() > until:
                    raise TimeoutError
                time.sleep(_PERIOD)
        finally:
            self.kill(wait=5.0)
        return found

    def send(self, line: str) -> None:
        """Send a line to the program; never blocks, and does nothing after its end."""
        self._orders.put(line.encode() + b"\n")

    def end_input(self) -> None:
        """Close its input after the sent lines: a trainer then writes a checkpoint and ends."""
        self._orders.put(None)

    def kill(self, *, wait: float = 0.0) -> None:
        """Kill the program and its children.

        Args:
            wait: Seconds to wait for its end.
        """
        if self._process.poll() is not None:
            return
        with contextlib.suppress(OSError):
            if sys.platform == "win32":
                self._process.kill()
            else:
                os.killpg(self._process.pid, signal.SIGKILL)
        if wait:
            self.wait(wait)

    def wait(self, timeout: float) -> bool:
        """Wait at most `timeout` seconds for the end of the process; True if it has ended."""
        try:
            self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            return False
        return True

    def _read_output(self) -> None:
        stream = self._process.stdout
        assert stream is not None
        for line in _read_lines(stream):
            self.last_line_at = time.monotonic()
            if self._lines.qsize() < _MOST_WAITING:
                self._lines.put(line)
        self._lines.put(None)
        self._orders.put(None)  # ends the writing thread

    def _read_errors(self) -> None:
        stream = self._process.stderr
        assert stream is not None
        for line in _read_lines(stream):
            self.last_line_at = time.monotonic()
            self._errors.append(line)
        self._errors_ended = True

    def _write_orders(self) -> None:
        """Write sent lines; a full pipe blocks this thread, not Blender."""
        stream = self._process.stdin
        assert stream is not None
        with contextlib.suppress(OSError, ValueError):
            while (order := self._orders.get()) is not None:
                stream.write(order)
                stream.flush()
        with contextlib.suppress(OSError, ValueError):
            stream.close()


def _own_session() -> dict[str, object]:
    if sys.platform == "win32":
        group = subprocess.CREATE_NEW_PROCESS_GROUP | subprocess.BELOW_NORMAL_PRIORITY_CLASS
        return {"creationflags": group | subprocess.CREATE_NO_WINDOW}
    return {"start_new_session": True}


def _read_lines(stream: BinaryIO) -> Iterator[str]:
    """Lines without line ends; invalid UTF-8 becomes the replacement character."""
    too_long = False
    with contextlib.suppress(OSError, ValueError), stream:
        while chunk := stream.readline(_LONGEST_LINE):
            whole = chunk.endswith(b"\n") or len(chunk) < _LONGEST_LINE
            if whole and not too_long:
                yield chunk.decode("utf-8", "replace").rstrip("\r\n")
            too_long = not whole
