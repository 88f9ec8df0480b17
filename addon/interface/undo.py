"""Undo steps for what is done beside operators."""

import bpy


def push(message: str) -> None:
    """Make what was done a step of its own: else undoing the user's next step undoes this too."""
    window = next(iter(bpy.context.window_manager.windows), None)
    if window is not None:
        with bpy.context.temp_override(window=window):
            bpy.ops.ed.undo_push(message=message)
