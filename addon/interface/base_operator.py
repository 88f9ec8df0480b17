"""Base operators: errors become reports and leave the scene unchanged; some ask to confirm."""

import textwrap
from collections.abc import Callable, Iterable
from typing import ClassVar, NamedTuple

import bpy
from bpy.props import BoolProperty

from ..core import GsError
from . import editable_check
from .option_labels import error_text


class Condition(NamedTuple):
    """When an operator can run."""

    holds: Callable[[bpy.types.Context], bool]
    message: str = ""
    """Why the button is greyed out."""


class BaseOperator:
    """Mixed in before bpy.types.Operator; an operator's class has the name of its button."""

    needs = Condition(lambda context: True)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """True if `needs` holds; else Blender shows its message on the button."""
        if cls.needs.holds(context):
            return True
        if cls.needs.message:
            cls.poll_message_set(cls.needs.message)
        return False

    def run(self, context: bpy.types.Context) -> str | None:
        """Run the operator; the text of its report, None or empty for none.

        Raises:
            GsError, ValueError, OSError: the operator fails; the message is for the user.
        """
        raise NotImplementedError

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """Datablocks that `run` changes; it runs only if Blender keeps changes of all of them.

        Raises:
            ValueError: as `run`.
        """
        return ()

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Entry point of Blender."""
        try:
            editable_check.check(*self.changes(context))
            message = self.run(context)
        except (GsError, ValueError, OSError) as error:
            return self.refuse(error)
        if message:
            self.report({"INFO"}, message)
        return {"FINISHED"}

    def refuse(self, error: Exception) -> set[str]:
        """Report an error with the panels' option names; returns the operator's result."""
        self.report({"ERROR"}, error_text(error))
        return {"CANCELLED"}

    def warn(self, sentences: Iterable[str]) -> None:
        """Report warnings."""
        for sentence in sentences:
            self.report({"WARNING"}, sentence)


class Undoable(BaseOperator):
    """Base of operators with an undo step and redo settings."""

    bl_options: ClassVar = {"REGISTER", "UNDO"}


class OnScene(Undoable):
    """Base of operators that change the scene."""

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """The scene."""
        return (context.scene,)


class Waiting(BaseOperator):
    """Base of operators that start work in the background."""

    bl_options: ClassVar = {"REGISTER"}

    wait: BoolProperty(
        name="Wait",
        description="Return when the work is complete; for scripts",
        options={"HIDDEN", "SKIP_SAVE"},
    )


class Browsing:
    """Mixin in before `BaseOperator`: a button opens the file browser, unless it gives a file."""

    given: ClassVar[tuple[str, ...]] = ()
    """Properties of which one is set if the button gives a file."""

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser."""
        if any(getattr(self, name) for name in self.given):
            return self.execute(context)
        return browse(context, self)


def browse(context: bpy.types.Context, operator: bpy.types.Operator) -> set[str]:
    """Open the file browser for an operator; returns its result."""
    context.window_manager.fileselect_add(operator)
    return {"RUNNING_MODAL"}


def make_active(context: bpy.types.Context, ob: bpy.types.Object) -> None:
    """Select only one object, and make it active; another active object returns to Object Mode."""
    if (before := context.object) is not None and before != ob and before.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")  # else it would stay in its mode, inactive
    make_active_in(context.view_layer, ob)


def make_active_in(layer: bpy.types.ViewLayer, ob: bpy.types.Object) -> None:
    """Like `make_active`, in a view layer that need not be shown in a window."""
    for other in layer.objects.selected:
        if other is not None:  # None: removed, and the layer is not yet updated
            other.select_set(False, view_layer=layer)
    ob.select_set(True, view_layer=layer)
    layer.objects.active = ob


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


def letters() -> int:
    """Characters per line in the drawn region."""
    context = bpy.context
    width = context.region.width if context.region else 260
    # A letter is about 6.2 px wide at a scale of 1; margins and the icon take 60 px.
    scale = context.preferences.system.ui_scale or 1.0  # 0 without a window
    return max(int((width / scale - 60) / 6.2), 20)


class ConfirmMixin:
    """Mixed in before `BaseOperator`: shows `confirm_lines` in a dialog before `execute`; Enter
    cancels."""

    confirm = "OK"
    """Text of the confirm button."""

    def confirm_lines(self, context: bpy.types.Context) -> list[str]:
        """Sentences about the effects; none: no confirmation is needed.

        Raises:
            GsError, ValueError, OSError: the operator fails; the message is for the user.
        """
        raise NotImplementedError

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Show the dialog."""
        try:
            editable_check.check(*self.changes(context))
            self.lines = self.confirm_lines(context)
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
