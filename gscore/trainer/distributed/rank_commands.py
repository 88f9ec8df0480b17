"""Rank commands: JSON messages by which rank 0 tells the other ranks what to run next."""

from typing import Any

BEGIN, STEP, RESTORE, END = "begin", "step", "restore", "end"
COLLECT = "collect"


def begin(facts: dict[str, Any], config: dict[str, Any], data: dict[str, Any]) -> dict[str, Any]:
    """Read the photos and make a trainer with these options, for a run that begins like this."""
    return {"do": BEGIN, "facts": facts, "config": config, "data": data}


def take_step(iterations: int, rate_factor: float) -> dict[str, Any]:
    """A step of a run of this length, all learning rates multiplied."""
    return {"do": STEP, "iterations": iterations, "rate_factor": rate_factor}


def restore(state: dict[str, Any]) -> dict[str, Any]:
    """Go on from the state of a trainer, whose tensors follow."""
    return {"do": RESTORE, "state": state}


def collect() -> dict[str, Any]:
    """Give rank 0 what it needs for a checkpoint."""
    return {"do": COLLECT}


def end(*, failed: bool) -> dict[str, Any]:
    """Nothing is left to do, or rank 0 cannot go on and has said why."""
    return {"do": END, "failed": failed}
