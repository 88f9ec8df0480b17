"""Verb jobs: all jobs of gscore commands in this Blender session, of all files: launch, poll,
follow to the end, release; and the bases of their operators.
"""

import atexit
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import bpy

from .. import preferences, stored_paths
from ..capture.folders import same_folder
from ..interface.base_operator import BaseOperator, Waiting
from ..interface.incremental_operator import with_readable_errors
from ..process import poll_timer
from ..process.incremental_tasks import Steps, run_in_thread
from ..splats import settings
from ..splats.write_chunked import ChunkedWrite, filled
from ..trainer_python import setup
from . import loader
from .verb_job import FAILED, Verb, VerbJob

JobT = TypeVar("JobT")

_INTERVAL = 0.02
"""Seconds between two polls of pending work."""


def launch(make: Callable[[Path], JobT]) -> JobT:
    """Start a job in the background, by `make` with the Python of the preferences.

    Raises:
        ValueError: there is no such Python, or it cannot be run.
    """
    program = setup.trainer_python(preferences.get())
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


def own_arguments(ob: bpy.types.Object) -> list[str]:
    """Arguments of a verb on the run of a splat object: the capture, if it is still there, and the
    threads of the preferences."""
    arguments = []
    source = stored_paths.read(ob, stored_paths.SOURCE)
    if source and Path(source).is_dir():
        arguments += ["-s", source]
    if threads := preferences.get().threads:
        arguments += ["--threads", str(threads)]
    return arguments


class VerbJobs:
    """The last job of each verb and source."""

    def __init__(self) -> None:
        self._jobs: list[VerbJob] = []

    def jobs(self, verb: Verb | None = None) -> list[VerbJob]:
        """All jobs, or those of a verb."""
        return [job for job in self._jobs if verb in (None, job.verb)]

    def of_source(self, verb: Verb, source: Path) -> VerbJob | None:
        """The last job of a source."""
        return next((job for job in self.jobs(verb) if same_folder(job.source, source)), None)

    def check_free(self, verb: Verb, source: Path) -> None:
        """Raise ValueError if a job of a source prevents another one."""
        job = self.of_source(verb, source)
        if job is not None and (job.awaits_import or (job.busy if verb.waits else not job.ended)):
            raise ValueError(verb.running.format(source))

    def start(
        self,
        verb: Verb,
        arguments: Sequence[str],
        *,
        source: Path,
        wait: bool = False,
        **more: Any,
    ) -> VerbJob:
        """Start a job in the background, and follow it.

        Args:
            verb: Its command.
            arguments: As `VerbJob`.
            source: As `VerbJob`.
            wait: Return when the job has ended and its result is imported.
            more: Further arguments of `VerbJob`.

        Raises:
            ValueError: as `check_free` and `launch`.
        """
        self.check_free(verb, source)
        known = {"source": source, "after": self.of_source(verb, source), **more}
        job = launch(lambda python: VerbJob(verb, python, arguments, **known))
        self._jobs = [other for other in self._jobs if other is not known["after"]]
        self._jobs.append(job)
        poll_timer.ensure()
        follow(lambda: wait and (not job.ended or job.awaits_import))
        return job

    def release_all(self) -> None:
        """Release all jobs: they end soon."""
        for job in self._jobs:
            job.leave()
        self._jobs.clear()

    def kill_all(self) -> None:
        """Kill all jobs; for tests."""
        for job in self._jobs:
            job.kill(wait=60)
        self._jobs.clear()


JOBS = VerbJobs()
"""Jobs of this Blender session."""


def mesh_of(path: Path) -> Steps[bpy.types.Mesh]:
    """The mesh of `loaded_mesh`; raises like it."""
    return (yield from loaded_mesh(path))[0]


def loaded_mesh(path: Path) -> Steps[tuple[bpy.types.Mesh, loader.Loaded]]:
    """Import the splats of a file into a mesh, owned by the caller, and what the file states.

    Raises:
        ValueError: the file cannot be read.
    """
    loaded = yield from run_in_thread(
        lambda check: loader.load(path, final=True), "Importing the splats"
    )
    if loaded.problem:
        raise ValueError(loaded.problem)
    yield from settings.building()
    [mesh] = yield from filled([ChunkedWrite(loaded)])
    return mesh, loaded


def _collect() -> bool:
    """Run a short step of each job; True if panels changed."""
    stale = False
    for job in JOBS.jobs():
        if job.poll():
            stale = True
            for lookup in job.verb.expires if job.ended else ():
                lookup.expire()
        elif job.preparing is not None:
            stale |= job.prepare_step(lambda job=job: begin(job.python, job.begin))
        else:
            stale |= import_next(job)
    return stale


def import_next(job: VerbJob) -> bool:
    """Run the next step of importing a finished job's result; True if panels changed.

    Does nothing while Blender renders or a mesh is edited.
    """
    if not job.awaits_import or bpy.app.is_job_running("RENDER") or bpy.context.mode != "OBJECT":
        return False
    if job.verb.has_place(job):
        return job.arrive_step(with_readable_errors)
    job.give_up()
    return True


_POLLER = poll_timer.Poller(
    _collect,
    lambda: any(not job.ended or job.awaits_import for job in JOBS.jobs()),
    lambda: any(job.import_task is not None for job in JOBS.jobs()),
)
APPENDED = ((poll_timer.POLLERS, _POLLER),)
on_register, on_unregister = released_at_quit(JOBS.release_all)


class Starting(Waiting):
    """Mixin before bpy.types.Operator that starts a job."""

    def run(self, context: bpy.types.Context) -> str:
        """Start the job."""
        return ended(self.start(context))

    def start(self, context: bpy.types.Context) -> VerbJob:
        """Start the job; errors as `run`."""
        raise NotImplementedError


class Cancelling(BaseOperator):
    """Mixin before bpy.types.Operator that cancels the scene's job of a verb."""

    none = ""
    """Message if there is nothing to cancel."""

    def run(self, context: bpy.types.Context) -> None:
        """Cancel the job."""
        job = self.job_of(context.scene)
        if job is None or job.ended:
            raise ValueError(self.none)
        job.cancel()
        poll_timer.redraw()

    def job_of(self, scene: bpy.types.Scene) -> VerbJob | None:
        """The scene's job."""
        raise NotImplementedError


def ended(job: VerbJob) -> str:
    """Message on the end of a job; empty while it is running.

    Raises:
        ValueError: it failed.
    """
    if job.status == FAILED:
        raise ValueError(job.sentence)
    return job.sentence
