"""Depth networks by name: those installed here, queried from the trainer's Python; no bpy.

Their cache belongs to a library that Blender's own Python does not have.
"""

import json
import time
from typing import Any

from ..process.child_program import Process

_TIMEOUT = 60.0
"""Seconds for an answer from a cold disk."""


def networks_here(python: str) -> frozenset[str]:
    """Names of the installed networks; for a thread.

    Raises:
        ValueError: the Python gave no answer.
    """
    problem = f"{python} cannot list depth networks; press Check in the add-on's preferences."
    try:
        process = Process([python, "-m", "gscore", "depth", "--list-models", "--json"])
    except OSError as error:
        raise ValueError(problem) from error
    try:
        until, output = time.monotonic() + _TIMEOUT, []
        while not process.ended and time.monotonic() < until:
            output += list(process.lines(0.1))
            time.sleep(0.05)
        output += list(process.lines(0.1))
    finally:
        process.kill(wait=5.0)
    for line in reversed(output):
        if (names := _names(line)) is not None:
            return names
    raise ValueError(problem)


def _names(line: str) -> frozenset[str] | None:
    try:
        rows: Any = json.loads(line)["models"]
        return frozenset(str(row["name"]) for row in rows if row["file"])
    except (ValueError, KeyError, TypeError):
        return None
