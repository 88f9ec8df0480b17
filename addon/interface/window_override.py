"""Window override: the window for operators that are called without a click."""

from collections.abc import Iterator
from contextlib import contextmanager

import bpy


@contextmanager
def in_a_window() -> Iterator[bool]:
    """Give operators called within a window; yields True if there is one.

    An existing window is not overridden: with Python 3.11 (Blender up to 5.0) an operator reads
    the override without Python's lock, and Blender sometimes crashes if a thread runs meanwhile.
    """
    context = bpy.context
    windows = list(context.window_manager.windows)
    if context.window is not None:
        yield True
    elif windows:
        with context.temp_override(window=windows[0]):
            yield True
    else:
        yield False
