"""Training jobs for panel and scripts: `train`, `resume`, `wait_for`, `discard` and `job_of`.

`job.pause()`, `job.unpause()`, `job.stop()` and `job.snapshot()` are methods of the job that
`train` returns. The modules training_job, run_state, curve, options, loader, registry,
existing_run and lookups need no bpy.
"""

from importlib import import_module
from typing import Any

_FUNCTIONS = ("discard", "job_of", "resume", "train", "wait_for")


def __getattr__(name: str) -> Any:
    """Import `start_training` at first use, because it needs bpy."""
    if name not in _FUNCTIONS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(".start_training", __name__), name)
