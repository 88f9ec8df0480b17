"""An operator that is under way in a window: its timer, and what the status bar says of it."""

import time

import bpy

INTERVAL = 0.01
"""Seconds between two steps."""
REDRAW = 0.25
"""Seconds between two changes of what the status bar says."""


class Waiting:
    """Begins with the operator, and has to be ended with it."""

    def __init__(self, context: bpy.types.Context, hint: str) -> None:
        """Have a timer sent to the window.

        Args:
            context: Of the operator.
            hint: Which key does what; follows each sentence.
        """
        self._hint = hint
        self._workspace = context.workspace
        self._timer = context.window_manager.event_timer_add(INTERVAL, window=context.window)
        self._told, self._when = "", 0.0

    def tell(self, sentence: str) -> None:
        """Show a sentence in the status bar; not more often than one can read it."""
        now = time.monotonic()
        if sentence != self._told and now - self._when > REDRAW:
            self._told, self._when = sentence, now
            self._workspace.status_text_set(f"{sentence}   |   {self._hint}")

    def end(self) -> None:
        """Take both back."""
        bpy.context.window_manager.event_timer_remove(self._timer)
        self._workspace.status_text_set(None)
