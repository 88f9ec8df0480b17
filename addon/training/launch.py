"""Launch of background jobs by operators and scripts: start, follow to the end, release."""

import atexit
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from .. import preferences
from ..process import poll_timer
from ..trainer_python import setup

JobT = TypeVar("JobT")

_INTERVAL = 0.02
"""Seconds between two polls of pending work."""


def launch(make: Callable[[str | Path], JobT], python: str | Path | None) -> JobT:
    """Start a job in the background.

    Args:
        make: Starts it with a given Python; raises OSError if that cannot be run.
        python: The Python to run; None: the one of the preferences.

    Raises:
        ValueError: there is no such Python, or it cannot be run.
    """
    program = python or setup.trainer_python(preferences.get())
    return begin(program, lambda: make(program))


def begin(program: str | Path, start: Callable[[], JobT]) -> JobT:
    """Call a function that starts a process.

    Raises:
        ValueError: OSError was raised; the message names `program` and the remedy.
    """
    try:
        return start()
    except OSError as error:
        raise ValueError(
            f"{program} cannot be run ({error.strerror or error}); press Check in the add-on's "
            "preferences."
        ) from error


def follow(waits: Callable[[], bool]) -> None:
    """Run the poll timer's work until nothing is pending; needed without a window."""
    while waits():
        poll_timer.poll()
        time.sleep(_INTERVAL)


class Following:
    """Registration of a folder's pollers, and the end of its jobs when Blender quits."""

    def __init__(
        self, pollers: Sequence[poll_timer.Poller], release_all: Callable[[], object]
    ) -> None:
        """Store the pollers; `on_register` starts them.

        Args:
            pollers: Pollers, in order.
            leave_all: Releases all jobs, which then end on their own.
        """
        self._pollers, self._leave_all = tuple(pollers), release_all

    def on_register(self) -> None:
        """Start the pollers."""
        poll_timer.POLLERS.extend(self._pollers)
        atexit.register(self._leave_all)

    def on_unregister(self) -> None:
        """Stop the pollers and release the jobs."""
        for poller in self._pollers:
            poll_timer.POLLERS.remove(poller)
        atexit.unregister(self._leave_all)
        self._leave_all()
