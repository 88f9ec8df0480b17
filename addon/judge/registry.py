"""The measurings of runs in this Blender session; no bpy."""

from ..job.verb_jobs import VerbJobs
from .job import ErrorsJob

JOBS: VerbJobs[ErrorsJob] = VerbJobs()
"""Those of each run."""
