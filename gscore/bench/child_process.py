"""Child process for measurements, with memory and caches of its own."""

import subprocess
import sys
from collections.abc import Sequence

from ..errors import BackendError

_ERROR = ": error: "
"""Prefix of the message of a failed verb."""


def run_child(arguments: Sequence[str], *, what: str) -> str:
    """Run Python with these arguments.

    Args:
        arguments: As after `python`.
        what: The process does, for the message.

    Returns:
        What it wrote to stdout.

    Raises:
        BackendError: it failed; the message ends in its own.
    """
    command = [sys.executable, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode < 0:
        raise BackendError(
            f"The process that {what} was ended by signal {-done.returncode}; if nobody did that, "
            "memory ran out: try fewer splats or smaller pictures."
        )
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
        own = next((line.partition(_ERROR)[2] for line in lines if _ERROR in line), None)
        # Not its own words, so an error in gscore: all lines of it are wanted.
        said = own or "\n".join(lines)
        raise BackendError(f"The process that {what} failed: {said}")
    return done.stdout
