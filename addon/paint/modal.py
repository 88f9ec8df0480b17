"""Modal paint operator in 3D views."""

from collections.abc import Iterable
from typing import ClassVar

import bpy
from bpy.props import BoolProperty

from ..core import GsError
from ..interface.incremental_operator import StatusBar
from ..interface.windows import push_undo
from ..splats import objects
from ..splats.operators import OnSplats, edit_vertices
from .session import UNDO, Answer, Session, paintable


class Running:
    """The running paint session of this Blender; at most one."""

    def __init__(self) -> None:
        self.session: Session | None = None
        self._status: StatusBar | None = None
        """Key hints in the status bar."""

    def begin(self, context: bpy.types.Context) -> None:
        """Start painting, with the brush cursor and key hints in the status bar."""
        self.session, self._status = Session(), StatusBar(context.workspace)
        self.update_status(context)

    def update_status(self, context: bpy.types.Context) -> None:
        """Update the status bar."""
        self._status.show(self.session.sentence(context.window_manager.gscore_paint))

    def end(self) -> None:
        """End the session and clean up; no effect without one."""
        session, self.session = self.session, None
        if session is not None:
            session.close()
            self._status.show(None)


RUNNING = Running()


class PaintSplats(OnSplats, bpy.types.Operator):
    """Paint colors, opacities or the selection of splats with a brush in the 3D view. Press again
    to end painting"""

    bl_idname = "gscore.paint_splats"
    bl_label = "Paint Splats"
    bl_options: ClassVar = set()  # each stroke is a separate undo step

    once: BoolProperty(
        name="Once",
        description="Paint only the stroke that begins with this mouse press",
        options={"HIDDEN", "SKIP_SAVE"},
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """True if a splat object is active, in Object or Edit Mode."""
        if not super().poll(context):
            return False
        if context.mode in {"OBJECT", "EDIT_MESH"}:
            return True
        cls.poll_message_set("Go to Object Mode to paint splats")
        return False

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """The points."""
        return (objects.active_splats(context).data,)

    def run(self, context: bpy.types.Context) -> str:
        """Raise ValueError: painting needs a 3D view."""
        raise ValueError(
            "Paint Splats needs a 3D view in a window; scripts paint with gscore.paint_stroke."
        )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Start painting, or end the running session."""
        if RUNNING.session is not None:
            RUNNING.session.ended = True
            return {"CANCELLED"}
        if bpy.app.background or context.window is None:
            return self.execute(context)
        self._edited = ""
        try:
            edited = objects.active_splats(context).mode == "EDIT"
            ob = paintable(context)
        except (GsError, ValueError) as error:
            return self.refuse(error)
        if edited:
            self._edited = ob.name
            push_undo(UNDO)  # else undoing the first stroke would return to Edit Mode
        RUNNING.begin(context)
        answer = self.modal(context, event) if self.once else {"RUNNING_MODAL"}
        if RUNNING.session is not None:
            context.window_manager.modal_handler_add(self)
        return answer

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Pass an event to the session."""
        try:
            answer = RUNNING.session.take(context, event)
        except (GsError, ValueError) as error:
            self.refuse(error)
            answer = Answer.TAKEN
        except BaseException:
            RUNNING.end()
            raise
        if self.once and not RUNNING.session.painting:
            answer = Answer.ENDED
        if answer is Answer.ENDED:
            RUNNING.end()
            self._edit_again(context)
        else:
            RUNNING.update_status(context)
        return {answer.value}

    def cancel(self, context: bpy.types.Context) -> None:
        """Clean up; called by Blender before a file load or its end."""
        RUNNING.end()

    def _edit_again(self, context: bpy.types.Context) -> None:
        """Return to Edit Mode, if painting started there."""
        ob = context.view_layer.objects.get(self._edited) if self._edited else None
        if objects.is_splats(ob) and ob.visible_get() and ob.mode == "OBJECT":
            edit_vertices(context, ob)
            push_undo(UNDO)


def on_unregister() -> None:
    """End the running session, whose operator is unregistered."""
    RUNNING.end()
