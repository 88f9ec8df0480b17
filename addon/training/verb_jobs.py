"""Verb jobs: all jobs of one gscore command in this Blender session, of all files; no bpy."""

from pathlib import Path
from typing import Generic, TypeVar

from ..capture.folders import same_folder
from .verb_job import VerbJob

JobT = TypeVar("JobT", bound=VerbJob)


class VerbJobs(Generic[JobT]):
    """The last job of each source."""

    def __init__(self) -> None:
        self._jobs: list[JobT] = []

    def add(self, job: JobT) -> None:
        """Add a job; replaces an earlier one of the same source, which has ended."""
        self._jobs[:] = [other for other in self._jobs if not same_folder(other.source, job.source)]
        self._jobs.append(job)

    def jobs(self) -> list[JobT]:
        """All jobs."""
        return list(self._jobs)

    def of_source(self, source: Path) -> JobT | None:
        """The last job of a source."""
        return next((job for job in self._jobs if same_folder(job.source, source)), None)

    def waits(self) -> bool:
        """True if a job is running."""
        return any(not job.ended for job in self._jobs)

    def leave_all(self) -> None:
        """Release all jobs: they end soon."""
        for job in self._jobs:
            job.leave()
        self._jobs.clear()
