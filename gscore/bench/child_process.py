"""Child process for measurements, with its own memory and caches."""

import subprocess
import sys
from collections.abc import Sequence

from ..errors import BackendError

_ERROR = ": error: "
"""Prefix of the message of a failed verb."""


def run_child(arguments: Sequence[str], *, what: str) -> str:
    """Run Python with these arguments.

    Args:
        arguments: Arguments after `python`.
        what: Verb phrase for messages, such as "measures a step".

    Returns:
        The text on stdout.

    Raises:
        BackendError: it failed; the message ends with that of the process.
    """
    command = [sys.executable, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode < 0:
        raise BackendError(
            f"The process that {what} was ended by signal {-done.returncode}, probably because "
            "memory ran out: try fewer splats or smaller pictures."
        )
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
        own = next((line.partition(_ERROR)[2] for line in lines if _ERROR in line), None)
        # Without a message of a verb it is an error inside gscore: report all lines.
        message = own or "\n".join(lines)
        raise BackendError(f"The process that {what} failed: {message}")
    return done.stdout
