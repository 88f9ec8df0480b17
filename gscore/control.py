"""Control: stop, pause and other requests to running work from threads, signals or a pipe."""

import os
import stat
import threading
import time
from collections import deque
from collections.abc import Callable

COMMANDS = ("stop", "pause", "resume", "snapshot")
"""Commands of `submit`."""


class Control:
    """Requests of a front end to a trainer, polled between two steps.

    Plain attributes instead of locks: a signal handler runs in the middle of the code that it
    interrupts, so a lock could be held by itself.
    """

    def __init__(self) -> None:
        self.stop_reason = ""
        """Reason to write a checkpoint and stop; empty: none."""
        self.paused = False
        self._snapshots = 0
        self._unknown: deque[str] = deque(maxlen=100)

    def stop(self, reason: str = "stopped") -> None:
        """Request a checkpoint and a stop; the first reason counts."""
        self.stop_reason = self.stop_reason or reason

    def pause(self) -> None:
        """Request a pause before the next step."""
        self.paused = True

    def resume(self) -> None:
        """Request to resume after a pause."""
        self.paused = False

    def snapshot(self) -> None:
        """Request a snapshot of the current splats."""
        self._snapshots += 1

    def submit(self, line: str) -> None:
        """Execute a command line; unknown lines are stored for `unknown`."""
        command = line.strip()
        if command in COMMANDS:
            getattr(self, command)()
        elif command:
            self._unknown.append(command)

    @property
    def stopping(self) -> bool:
        """True after a stop request."""
        return bool(self.stop_reason)

    def take_snapshot(self) -> bool:
        """True after a snapshot request since the last call."""
        requested, self._snapshots = self._snapshots > 0, 0
        return requested

    def unknown(self) -> list[str]:
        """Unknown lines since the last call."""
        lines = []
        while self._unknown:
            lines.append(self._unknown.popleft())
        return lines

    def wait_while_paused(
        self,
        *,
        is_paused: Callable[[], bool] = lambda: False,
        meanwhile: Callable[[], None] = lambda: None,
    ) -> None:
        """Return when training may continue or must end, or after any other request.

        Args:
            is_paused: Returns True while another party, such as a viewer, pauses the training.
            meanwhile: Called repeatedly.
        """
        while (self.paused or is_paused()) and not (
            self.stopping or self._snapshots or self._unknown
        ):
            meanwhile()
            time.sleep(0.02)


def listen(control: Control, descriptor: int, *, on_end: Callable[[], None]) -> threading.Thread:
    """Feed the lines of a file descriptor to `control` from a daemon thread.

    Args:
        control: Receives the lines.
        descriptor: Read until its end. Unlike sys.stdin, `os.read` takes no Python lock, so a
            thread waiting in it does not block the interpreter's exit.
        on_end: Called at the end of the input if that means that the parent process has ended.
    """

    def read() -> None:
        rest = b""
        while chunk := _read(descriptor):
            *lines, rest = (rest + chunk).split(b"\n")
            for line in lines:
                control.submit(line.decode("utf-8", "replace"))
        if end_means_parent_gone(descriptor):
            on_end()

    thread = threading.Thread(target=read, name="gscore-control", daemon=True)
    thread.start()
    return thread


def end_means_parent_gone(descriptor: int) -> bool:
    """True for pipes and sockets; files, terminals and /dev/null end while the parent runs."""
    try:
        mode = os.fstat(descriptor).st_mode
    except OSError:
        return False
    return stat.S_ISFIFO(mode) or stat.S_ISSOCK(mode)


def _read(descriptor: int) -> bytes:
    try:
        return os.read(descriptor, 4096)
    except OSError:
        return b""
