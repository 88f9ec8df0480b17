"""The program `gscore`, also `python -m gscore`: command line with early signal handlers.

Few modules are imported before the handlers are set: until then Ctrl-C ends in a traceback.
"""

import os
import signal
import sys

from .ending_signals import ending_signals


def main() -> int:
    """Run the command line of this process; returns its exit code."""
    numbers = ending_signals()
    for number in numbers:
        signal.signal(number, _leave)  # nothing is open yet, so nothing needs cleanup
    from .commands import main as run

    code = run()
    for number in numbers:
        signal.signal(number, signal.SIG_IGN)  # the work is done; Python's exit takes a moment
    return code


def _leave(number: int, frame: object) -> None:
    try:
        os.write(2, b"Stopped.\n")
    finally:  # stderr may be closed
        os._exit(128 + number)


if __name__ == "__main__":
    sys.exit(main())
