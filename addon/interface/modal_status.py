"""Modal status of a running operator in a window: its timer and the status bar text."""

import time

import bpy

INTERVAL = 0.01
"""Seconds between two steps."""
REDRAW = 0.25
"""Interval of changes of the status bar, seconds."""


class StatusBar:
    """Status bar of a workspace, which may be deleted meanwhile."""

    def __init__(self, workspace: bpy.types.WorkSpace) -> None:
        """Initialise without a text."""
        self._uid = workspace.session_uid

    def show(self, text: str | None) -> None:
        """Show a text; None: Blender's default."""
        for workspace in bpy.data.workspaces:
            if workspace.session_uid == self._uid:
                workspace.status_text_set(text)


class ModalStatus:
    """Timer and status text of an operator, from its start to its end."""

    def __init__(self, context: bpy.types.Context, hint: str) -> None:
        """Start a timer in the window.

        Args:
            context: The operator's context.
            hint: Key hints after each sentence.
        """
        self._hint = hint
        self._status = StatusBar(context.workspace)
        self._timer = context.window_manager.event_timer_add(INTERVAL, window=context.window)
        self._sentence, self._when = "", 0.0

    def show(self, sentence: str) -> None:
        """Show a sentence in the status bar, at a readable rate."""
        now = time.monotonic()
        if sentence != self._sentence and now - self._when > REDRAW:
            self._sentence, self._when = sentence, now
            self._status.show(f"{sentence}   |   {self._hint}")

    def end(self) -> None:
        """Remove timer and text."""
        bpy.context.window_manager.event_timer_remove(self._timer)
        self._status.show(None)
