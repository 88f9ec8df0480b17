"""Window override: the window for operators that are called without a click."""

from collections.abc import Iterator
from contextlib import contextmanager

import bpy


@contextmanager
def in_a_window() -> Iterator[bool]:
    """Operators called within have a window; yields whether they do.

    Nothing is overridden where there is one. With Python 3.11, which Blender has up to 5.0, an
    operator looks up what was overridden without holding Python's lock: Blender crashes now and
    then where a thread runs meanwhile.
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
