"""Job registry: the errors jobs of this Blender session; no bpy."""

from ..training.verb_jobs import VerbJobs
from .errors_job import ErrorsJob

JOBS: VerbJobs[ErrorsJob] = VerbJobs()
"""Jobs by run."""
