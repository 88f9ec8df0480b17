"""Blender's windows: one for operators that are called without a click, undo steps, redraws."""

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


def push_undo(message: str) -> None:
    """Add an undo step; without it, undoing the user's next step would undo this change too."""
    with in_a_window() as there_is_a_window:
        if there_is_a_window:
            bpy.ops.ed.undo_push(message=message)


def redraw_views() -> None:
    """Redraw all 3D views."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()
