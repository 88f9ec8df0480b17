"""Job registry: the region trainings of this Blender session; no bpy."""

from ..training.verb_jobs import VerbJobs
from .job import RegionJob

JOBS: VerbJobs[RegionJob] = VerbJobs()
"""Jobs by capture."""
