"""Confirmation operators: a dialog that lists the effects of an action that cannot be undone."""

import textwrap

import bpy

from ..core import GsError
from . import editable_check

WIDTH = 90
"""Characters per line in a dialog and in the preferences."""
_PIXELS = 520


def wrapped(
    layout: bpy.types.UILayout, text: str, *, icon: str = "NONE", width: int = WIDTH
) -> None:
    """Draw a sentence as several labels, because Blender's labels do not wrap.

    Args:
        layout: Parent of the column with the labels.
        text: The sentence.
        icon: Icon of the first line.
        width: Characters per line.
    """
    column = layout.column(align=True)
    column.scale_y = 0.8
    for number, line in enumerate(textwrap.wrap(text, width) or [""]):
        column.label(text=line, icon="BLANK1" if number and icon != "NONE" else icon)


def letters(context: bpy.types.Context) -> int:
    """Characters per line in the drawn region."""
    width = context.region.width if context.region else 260
    # A letter is about 6.2 px wide at a scale of 1; margins and the icon take 60 px.
    scale = context.preferences.system.ui_scale or 1.0  # 0 without a window
    return max(int((width / scale - 60) / 6.2), 20)


class ConfirmMixin:
    """Mixed in before `BaseOperator`: shows `question` in a dialog before `execute`; Enter
    cancels."""

    confirm = "OK"
    """Text of the confirm button."""

    def question(self, context: bpy.types.Context) -> list[str]:
        """Sentences about the effects; none: no confirmation is needed.

        Raises:
            GsError, ValueError, OSError: the operator fails; the message is for the user.
        """
        raise NotImplementedError

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Show the dialog."""
        try:
            editable_check.check(*self.changes(context))
            self.lines = self.question(context)
        except (GsError, ValueError, OSError) as error:
            return self.refuse(error)
        if not self.lines:
            return self.execute(context)
        return context.window_manager.invoke_props_dialog(
            self,
            width=_PIXELS,
            title=self.bl_label,
            confirm_text=self.confirm,
            cancel_default=True,
        )

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the sentences in place of the operator's properties."""
        for line in getattr(self, "lines", ()):  # none in a redo panel
            wrapped(self.layout, line, icon="DOT")
