"""Paint operators: modal in 3D views, and of strokes for scripts and redo."""

from collections.abc import Iterable
from typing import ClassVar

import bpy
import numpy as np
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    StringProperty,
)

from ..cameras.render_camera import RenderCamera, render_camera
from ..core import GsError
from ..interface.incremental_operator import StatusBar
from ..interface.windows import push_undo
from ..process.incremental_tasks import Steps
from ..splats import objects
from ..splats.edit_guard import EditGuard
from ..splats.edit_operators import Editing
from ..splats.operators import OnSplats, edit_vertices
from . import paint_target
from .session import UNDO, Answer, Session, paintable
from .settings import FRONT_ONLY, BrushProperties


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
    """Paint colors, opacities or the selection of splats, or copies, with a brush in the 3D view.
    Press again to end painting"""

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
        if self.once and not RUNNING.session.busy:
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


_CAMERA, _PLACES = "CAMERA", "PLACES"
_WAYS = [
    (_CAMERA, "Camera", "Through a camera: points are pixels of its picture"),
    (_PLACES, "World", "In space: points are positions in Blender's world"),
]


class StrokePoint(bpy.types.PropertyGroup):
    """A point of a stroke's path."""

    place: FloatVectorProperty(
        name="Position",
        description="Pixels from the lower left of the camera's picture, where z is ignored, or a "
        "position in Blender's world",
        size=3,
    )


class PaintStroke(BrushProperties, Editing, bpy.types.Operator):
    """Paint one stroke on splats, through a camera or in world space; for scripts"""

    bl_idname = "gscore.paint_stroke"
    bl_label = "Paint Stroke"

    stroke: CollectionProperty(
        name="Stroke",
        description="Points of the stroke's path",
        type=StrokePoint,
        options={"HIDDEN", "SKIP_SAVE"},
    )
    way: EnumProperty(name="Space", description="Space of the stroke's points", items=_WAYS)
    camera: StringProperty(
        name="Camera",
        description="Camera object to paint through, at the scene's resolution; empty: the scene's "
        "camera",
        options={"SKIP_SAVE"},
    )
    radius: FloatProperty(
        name="Radius",
        description="Radius of the brush, in pixels of the picture or in world units",
        min=1e-6,
        default=50.0,
    )
    front_only: BoolProperty(
        name="Front Only",
        description=f"{FRONT_ONLY}. No effect in world space",
        default=True,
    )
    inverted: BoolProperty(
        name="Inverted", description="Paint the opposite opacity, or deselect", default=False
    )

    def edit(self, context: bpy.types.Context, guard: EditGuard) -> Steps[str]:
        """Paint."""
        if not self.stroke:
            raise ValueError("The stroke has no points: add one or more.")
        ob = guard.there()
        view = self._view(context) if self.way == _CAMERA else None
        count = yield from paint_target.paint(
            ob,
            [self._point(point, view) for point in self.stroke],
            self.brush(inverted=self.inverted),
            view,
            source=np.array(context.scene.cursor.location, np.float64),
            front_only=self.front_only and view is not None,
            only_selected=self.only_selected,
        )
        return f"{count:,} splats painted."

    def _view(self, context: bpy.types.Context) -> RenderCamera:
        """The chosen camera at the scene's frame.

        Raises:
            ValueError: there is none, or its type is not supported.
        """
        scene = context.scene
        camera = scene.objects.get(self.camera) if self.camera else scene.camera
        if camera is None:
            missing = f"object {self.camera}" if self.camera else "camera"
            raise ValueError(f"The scene has no {missing} to paint through: choose a camera.")
        depsgraph = context.evaluated_depsgraph_get()
        return render_camera(camera, scene, depsgraph=depsgraph)

    @staticmethod
    def _point(point: StrokePoint, view: RenderCamera | None) -> np.ndarray:
        """A point in pixels from the top left, [2], or in the world, [3]."""
        if view is None:
            return np.array(point.place, np.float64)
        x, y, _ = point.place
        return np.array([x, view.height - y], np.float64)
