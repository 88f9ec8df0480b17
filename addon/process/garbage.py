"""Garbage collection of Python, postponed while many objects are created; no bpy."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager

_NEVER = 2**31 - 1
_before: list[int] = []
"""Threshold of the full collection, once per task that postpones it."""


@contextmanager
def put_off() -> Iterator[None]:
    """Within it Python looks for garbage among its younger objects alone.

    Where many have come it looks through all, those of Blender and of other add-ons among them, and
    every thread waits: 45 to 100 ms where thousands of cameras are read. Most of what work makes is
    gone when it ends, which needs no search.
    """
    young, middle, old = gc.get_threshold()
    if not _before:
        gc.set_threshold(young, middle, _NEVER)
    _before.append(_before[0] if _before else old)
    try:
        yield
    finally:
        before = _before.pop()
        young, middle, old = gc.get_threshold()
        if not _before and old == _NEVER:  # else other code has set another threshold
            gc.set_threshold(young, middle, before)
