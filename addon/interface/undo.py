"""Undo steps for changes outside operators."""

import bpy

from .window_override import in_a_window


def push(message: str) -> None:
    """Add an undo step; without it, undoing the user's next step would undo this change too."""
    with in_a_window() as there_is_a_window:
        if there_is_a_window:
            bpy.ops.ed.undo_push(message=message)
