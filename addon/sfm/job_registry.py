"""Job registry: the SfM jobs of this Blender session; no bpy."""

from ..training.verb_jobs import VerbJobs
from .job import SearchJob

JOBS: VerbJobs[SearchJob] = VerbJobs()
"""Jobs by folder of photos, or video."""
