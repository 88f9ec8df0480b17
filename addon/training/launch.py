"""Launch of background jobs by operators and scripts: start, follow to the end, release."""

import atexit
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from .. import preferences
from ..process import poll_timer
from ..trainer_python import setup
from .verb_job import VerbJob
from .verb_jobs import VerbJobs

JobT = TypeVar("JobT")
VerbJobT = TypeVar("VerbJobT", bound=VerbJob)

_BEAT = 0.02
"""Seconds between two looks at work that is waited for."""


def launch(make: Callable[[str | Path], JobT], python: str | Path | None) -> JobT:
    """Start a job.

    Args:
        make: Starts it with the Python that it is given; raises OSError where that cannot be run.
        python: The Python that works; None: as the preferences say.

    Raises:
        ValueError: there is no such Python, or it cannot be run; the message says what to do.
    """
    program = python or setup.trainer_python(preferences.get())
    return begin(program, lambda: make(program))


def begin(program: str | Path, start: Callable[[], JobT]) -> JobT:
    """Call what starts a process.

    Raises:
        ValueError: OSError came of it; the message says that `program` is why, and what to do.
    """
    try:
        return start()
    except OSError as error:
        raise ValueError(
            f"{program} cannot be run ({error.strerror or error}); press Check in the add-on's "
            "preferences."
        ) from error


def follow(waits: Callable[[], bool]) -> None:
    """Do what a beat does until nothing is waited for; without a window nothing else would."""
    while waits():
        poll_timer.poll()
        time.sleep(_BEAT)


def following_verb(
    jobs: VerbJobs[VerbJobT],
    ended: Callable[[], object],
    *,
    bring_in: Callable[[VerbJobT], bool] | None = None,
    wanted: Callable[[VerbJobT], bool] | None = None,
    hurries: Callable[[VerbJobT], bool] | None = None,
) -> "Following":
    """What follows the jobs of a verb.

    Args:
        jobs: Of this Blender session.
        ended: Is called when one has ended: what was looked up before may differ.
        bring_in: What else a beat does for a job that told nothing; whether panels changed.
        wanted: Whether a job that ended is still to be brought in; None: never.
        hurries: Whether it is on its way in, so that the next beat should come soon; None: never.
    """

    def collect() -> bool:
        stale = False
        for job in jobs.jobs():
            if job.poll():
                stale = True
                if job.ended:
                    ended()
            elif bring_in is not None:
                stale |= bring_in(job)
        return stale

    def waits() -> bool:
        return jobs.waits() or (wanted is not None and any(map(wanted, jobs.jobs())))

    def soon() -> bool:
        return hurries is not None and any(map(hurries, jobs.jobs()))

    return Following([poll_timer.Poller(collect, waits, soon)], jobs.leave_all)


class Following:
    """A room's part of the beat, and the end of its jobs with the end of Blender."""

    def __init__(
        self, followers: Sequence[poll_timer.Poller], leave_all: Callable[[], object]
    ) -> None:
        """Nothing is followed before `on_register`.

        Args:
            followers: What is done at a beat, in order.
            leave_all: Lets go of all jobs, each of which then ends by itself.
        """
        self._followers, self._leave_all = tuple(followers), leave_all

    def on_register(self) -> None:
        """Follow them."""
        poll_timer.FOLLOWERS.extend(self._followers)
        atexit.register(self._leave_all)

    def on_unregister(self) -> None:
        """Let go of them."""
        for follower in self._followers:
            poll_timer.FOLLOWERS.remove(follower)
        atexit.unregister(self._leave_all)
        self._leave_all()
