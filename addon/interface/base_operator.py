"""Base operator: errors become reports and leave the scene unchanged."""

from collections.abc import Iterable

import bpy

from ..core import GsError
from . import editable_check
from .option_labels import error_words


class BaseOperator:
    """Mixed in before bpy.types.Operator; an operator's class has the name of its button."""

    def act(self, context: bpy.types.Context) -> str:
        """Run the operator; the text of its report, or an empty string.

        Raises:
            GsError, ValueError, OSError: the operator fails; the message is for the user.
        """
        raise NotImplementedError

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """Datablocks that `act` changes; it runs only if Blender keeps changes of all of them.

        Raises:
            ValueError: as `act`.
        """
        return ()

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Entry point of Blender."""
        try:
            editable_check.check(*self.changes(context))
            message = self.act(context)
        except (GsError, ValueError, OSError) as error:
            return self.refuse(error)
        if message:
            self.report({"INFO"}, message)
        return {"FINISHED"}

    def refuse(self, error: Exception) -> set[str]:
        """Report an error with the panels' option names; returns the operator's result."""
        self.report({"ERROR"}, error_words(error))
        return {"CANCELLED"}

    def warn(self, sentences: Iterable[str]) -> None:
        """Report warnings."""
        for sentence in sentences:
            self.report({"WARNING"}, sentence)


class OnScene(BaseOperator):
    """Base of operators that change the scene."""

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """The scene."""
        return (context.scene,)


def make_active(context: bpy.types.Context, ob: bpy.types.Object) -> None:
    """Select only one object, and make it active."""
    make_active_in(context.view_layer, ob)


def make_active_in(layer: bpy.types.ViewLayer, ob: bpy.types.Object) -> None:
    """Like `make_active`, in a view layer that need not be shown in a window."""
    for other in layer.objects.selected:
        if other is not None:  # None: removed, and the layer is not yet updated
            other.select_set(False, view_layer=layer)
    ob.select_set(True, view_layer=layer)
    layer.objects.active = ob
