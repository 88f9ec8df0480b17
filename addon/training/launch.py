"""Launch of background jobs by operators and scripts: start, follow to the end, release."""

import atexit
import time
from collections.abc import Callable
from functools import partial
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


def released_at_quit(
    release_all: Callable[[], object],
) -> tuple[Callable[[], object], Callable[[], object]]:
    """`on_register` and `on_unregister` of a module whose jobs are released, to end on their own,
    when Blender quits or the add-on is disabled."""

    def end() -> None:
        atexit.unregister(release_all)
        release_all()

    return partial(atexit.register, release_all), end
