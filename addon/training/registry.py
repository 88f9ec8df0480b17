"""Registry of the trainings of this Blender session, of all files; no bpy."""

from pathlib import Path

from ..capture.folders import same_folder
from .training_job import Job

_jobs: dict[str, Job] = {}


def add(job: Job) -> None:
    """Add a job; replaces an earlier one of the same folder, which has ended."""
    for other in [j for j in _jobs.values() if same_folder(j.output, job.output)]:
        del _jobs[other.id]
    _jobs[job.id] = job


def remove(job: Job) -> None:
    """Remove a job."""
    _jobs.pop(job.id, None)


def jobs() -> list[Job]:
    """All jobs, the oldest first."""
    return list(_jobs.values())


def by_id(job_id: str) -> Job | None:
    """The job with this id."""
    return _jobs.get(job_id)


def by_output(output: Path) -> Job | None:
    """The job that trains or trained into a folder."""
    return next((job for job in _jobs.values() if same_folder(job.output, output)), None)


def release_all() -> None:
    """Release all jobs: each writes a checkpoint and ends."""
    for job in jobs():
        job.leave()
    _jobs.clear()
