"""Undo steps for what is done beside operators."""

import bpy

from .overriding import acting_in


def push(message: str) -> None:
    """Make what was done a step of its own: else undoing the user's next step undoes this too."""
    with acting_in() as there_is_a_window:
        if there_is_a_window:
            bpy.ops.ed.undo_push(message=message)
