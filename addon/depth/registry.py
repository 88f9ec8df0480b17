"""The depth jobs of this Blender session, whichever file is open; no bpy."""

from pathlib import Path

from ..capture.folders import same_folder
from .job import DepthJob

_jobs: list[DepthJob] = []


def add(job: DepthJob) -> None:
    """Keep a job; an earlier one of the same capture, which has ended, is forgotten."""
    _jobs[:] = [other for other in _jobs if not same_folder(other.source, job.source)]
    _jobs.append(job)


def jobs() -> list[DepthJob]:
    """The last job of each capture."""
    return list(_jobs)


def of_capture(source: Path) -> DepthJob | None:
    """The last job of a capture."""
    return next((job for job in _jobs if same_folder(job.source, source)), None)


def leave_all() -> None:
    """Let go of all: predictions end after a view."""
    for job in _jobs:
        job.leave()
    _jobs.clear()
