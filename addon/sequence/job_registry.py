"""Job registry: the sequence trainings of this session, with cached facts of folders; no bpy."""

from pathlib import Path

from ..core import DataConfig, SequenceFrame, SequenceIndex, find_frames, read_sequence
from ..interface.lookup import Lookup
from ..training.verb_jobs import VerbJobs
from .job import SequenceJob

JOBS: VerbJobs[SequenceJob] = VerbJobs()
"""Jobs by source."""
frames: Lookup[tuple[str, str], list[SequenceFrame]] = Lookup(
    lambda key: find_frames(DataConfig(source=Path(key[0]), images=key[1])), max_age=60.0
)
"""A capture's frames, by its path and the name of its photo folder."""
trained: Lookup[Path, SequenceIndex | None] = Lookup(read_sequence, max_age=3.0)
"""Index of an output folder."""


def collect() -> bool:
    """Collect finished lookups; return whether there were any."""
    return sum(found.collect() for found in (frames, trained)) > 0


def busy() -> bool:
    """Whether a lookup is running."""
    return frames.busy or trained.busy
