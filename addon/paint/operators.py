"""Paint operator for scripts: one whole stroke per call."""

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
from ..process.incremental_tasks import Steps
from ..splats.edit_guard import EditGuard
from ..splats.edit_operators import Editing
from . import paint_target
from .settings import FRONT_ONLY, BrushProperties

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
