"""Garbage collection of Python, postponed while many objects are created; no bpy."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager

_NEVER = 2**31 - 1
_before: list[int] = []
"""Previous threshold of the full collection, one entry per task that postpones it."""


@contextmanager
def defer_collections() -> Iterator[None]:
    """Disable full garbage collections; collections of younger objects continue.

    After many allocations Python scans all objects, including those of Blender and other add-ons,
    and blocks every thread: 45 to 100 ms while thousands of cameras are read. Most objects of such
    work are freed at its end without a scan.
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
