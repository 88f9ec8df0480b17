"""Modal status of a running operator in a window: its timer and the status bar text."""

import time

import bpy

INTERVAL = 0.01
"""Seconds between two steps."""
REDRAW = 0.25
"""Seconds between two changes of what the status bar says."""


class StatusBar:
    """That of a workspace, which may be deleted meanwhile."""

    def __init__(self, workspace: bpy.types.WorkSpace) -> None:
        """Nothing is said yet."""
        self._uid = workspace.session_uid

    def say(self, text: str | None) -> None:
        """Show a text there; None: what Blender itself says."""
        for workspace in bpy.data.workspaces:
            if workspace.session_uid == self._uid:
                workspace.status_text_set(text)


class ModalStatus:
    """Begins with the operator, and has to be ended with it."""

    def __init__(self, context: bpy.types.Context, hint: str) -> None:
        """Have a timer sent to the window.

        Args:
            context: Of the operator.
            hint: Which key does what; follows each sentence.
        """
        self._hint = hint
        self._status = StatusBar(context.workspace)
        self._timer = context.window_manager.event_timer_add(INTERVAL, window=context.window)
        self._told, self._when = "", 0.0

    def tell(self, sentence: str) -> None:
        """Show a sentence in the status bar; not more often than one can read it."""
        now = time.monotonic()
        if sentence != self._told and now - self._when > REDRAW:
            self._told, self._when = sentence, now
            self._status.say(f"{sentence}   |   {self._hint}")

    def end(self) -> None:
        """Take both back."""
        bpy.context.window_manager.event_timer_remove(self._timer)
        self._status.say(None)
