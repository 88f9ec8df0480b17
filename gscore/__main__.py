"""The program `gscore`, also `python -m gscore`: command line with early signal handlers."""

import contextlib
import os
import signal
import sys
from types import FrameType

from .control import ending_signals


def main() -> int:
    """Run the command line of this process; returns its exit code."""
    numbers = ending_signals()
    for number in numbers:
        signal.signal(number, _leave)  # nothing is open yet, so there is nothing to tidy up
    from .commands import main as run

    code = run()
    for number in numbers:
        signal.signal(number, signal.SIG_IGN)  # all is done; Python's own exit takes a moment
    return code


def _leave(number: int, frame: FrameType | None) -> None:
    with contextlib.suppress(OSError):  # perhaps nobody is there to read it
        os.write(2, b"Stopped.\n")
    os._exit(128 + number)


if __name__ == "__main__":
    sys.exit(main())
