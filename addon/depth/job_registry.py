"""Job registry: the depth jobs of this Blender session; no bpy."""

from ..training.verb_jobs import VerbJobs
from .job import DepthJob

JOBS: VerbJobs[DepthJob] = VerbJobs()
"""Jobs by capture."""
