"""Work of a call, counted instead of timed: the count is the same on every machine."""

import sys
from collections.abc import Callable
from types import FrameType


def lines_run(act: Callable[[], object]) -> int:
    """Lines of Python that `act` runs in this thread.

    Every pass of a Python loop counts, those of numpy and of other libraries in C do not: a count
    that stays the same for a thousand times the data means that no loop of Python handles them one
    by one.
    """
    count = 0

    def trace(frame: FrameType, event: str, argument: object) -> Callable:
        nonlocal count
        count += event == "line"
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        act()
    finally:
        sys.settrace(before)
    return count
