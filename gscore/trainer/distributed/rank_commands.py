"""Rank commands: JSON messages of rank 0 that the other ranks run."""

from typing import Any

from ..model.start_state import StartState

BEGIN, STEP, RESTORE, END = "begin", "step", "restore", "end"
COLLECT = "collect"


def begin(start: StartState, config: dict[str, Any], data: dict[str, Any]) -> dict[str, Any]:
    """Read the photos and the start splats of these options, and create a trainer."""
    facts = {"taken": start.taken, "stereo": start.stereo, "frame": start.frame}
    return {"do": BEGIN, "facts": facts, "config": config, "data": data}


def take_step(iterations: int, rate_factor: float) -> dict[str, Any]:
    """Run a step of a run of this length, with all learning rates scaled."""
    return {"do": STEP, "iterations": iterations, "rate_factor": rate_factor}


def restore(state: dict[str, Any]) -> dict[str, Any]:
    """Restore the state of a trainer; its tensors follow."""
    return {"do": RESTORE, "state": state}


def collect() -> dict[str, Any]:
    """Send rank 0 the state that a checkpoint needs."""
    return {"do": COLLECT}


def end(*, failed: bool) -> dict[str, Any]:
    """End: the run is complete, or rank 0 failed and reported the error."""
    return {"do": END, "failed": failed}
