"""Alignment operators of a capture: up direction, ground, size."""

from collections.abc import Iterable

import bpy
import numpy as np
from bpy.props import EnumProperty, FloatProperty

from ..compat import matrix_to_numpy
from . import capture_transform
from . import objects as co
from .lookup import OnCapture, find_root

_AXES = {"X": 0, "Y": 1, "Z": 2}


class _Aligning(OnCapture):
    """Base of operators that move the capture's empty and its children."""

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """The empty."""
        return (find_root(context, self.capture),)


class AlignCapture(_Aligning, bpy.types.Operator):
    """Rotate a capture upright and put its ground at height 0; its scale stays"""

    bl_idname = "gscore.align_capture"
    bl_label = "Align to Ground"

    up: EnumProperty(
        name="Up",
        items=(
            (
                "CAPTURE",
                "From Capture",
                "From GPS or the EXIF orientation of the photos; without them From Cameras",
            ),
            ("CAMERAS", "From Cameras", "Assume that most photos were taken level"),
            ("CURRENT", "Current", "Keep the current up direction and find the ground again"),
            ("VIEW", "Scene Camera", "Upper side of the scene camera's picture"),
            ("X", "+X", "The capture's own x axis"),
            ("-X", "-X", "Opposite to the capture's own x axis"),
            ("Y", "+Y", "The capture's own y axis"),
            ("-Y", "-Y", "Opposite to the capture's own y axis, as in many COLMAP models"),
            ("Z", "+Z", "The capture's own z axis"),
            ("-Z", "-Z", "Opposite to the capture's own z axis"),
        ),
        description="Approximate up direction; the level plane with most points is the ground",
    )

    def run(self, context: bpy.types.Context) -> None:
        """Align."""
        root = find_root(context, self.capture)
        alignment = capture_transform.align_root(root, self._up(context, root))
        if not alignment.ground_found:
            self.report({"WARNING"}, "No ground was found; the lowest points are at height 0.")

    def _up(self, context: bpy.types.Context, root: bpy.types.Object) -> np.ndarray | None:
        if self.up == "CAPTURE":
            return capture_transform.stated_up(root)
        if self.up == "CAMERAS":
            return capture_transform.stated_up(root, capture_transform.PHOTO_UP)
        if self.up == "CURRENT":
            return current_up(root)
        if self.up == "VIEW":
            if context.scene.camera is None:
                raise ValueError("The scene has no camera. Choose one with Use Camera.")
            depsgraph = context.evaluated_depsgraph_get()
            return -co.viewmat_in(context.scene.camera, root, depsgraph)[1, :3]
        sign = -1.0 if self.up.startswith("-") else 1.0
        return sign * np.eye(3)[_AXES[self.up[-1]]]


class FlipUp(_Aligning, bpy.types.Operator):
    """Turn a capture upside down, and find the ground again"""

    bl_idname = "gscore.flip_up"
    bl_label = "Flip Up"

    def run(self, context: bpy.types.Context) -> None:
        """Flip."""
        root = find_root(context, self.capture)
        capture_transform.align_root(root, -current_up(root))


class SetExtent(_Aligning, bpy.types.Operator):
    """Scale a capture to real size, by the distance between its outermost cameras"""

    bl_idname = "gscore.set_extent"
    bl_label = "Set Size"

    extent: FloatProperty(
        name="Camera Extent",
        default=5.0,
        min=1e-4,
        soft_max=1000.0,
        subtype="DISTANCE",
        unit="LENGTH",
        description="Distance in metres between the two cameras that are farthest apart",
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Show a dialog with the current size."""
        try:
            self.extent = capture_transform.world_extent(find_root(context, self.capture))
        except ValueError as error:
            return self.refuse(error)
        return context.window_manager.invoke_props_dialog(self)

    def run(self, context: bpy.types.Context) -> None:
        """Scale."""
        capture_transform.set_extent(find_root(context, self.capture), self.extent)


class ResetAlignment(_Aligning, bpy.types.Operator):
    """Restore the axes, origin and scale of the capture's own files"""

    bl_idname = "gscore.reset_alignment"
    bl_label = "Reset to COLMAP World"

    def run(self, context: bpy.types.Context) -> None:
        """Reset."""
        root = find_root(context, self.capture)
        capture_transform.set_root_matrix(root, np.eye(4))
        capture_transform.size_drawings(root, co.cameras_of(root))


def current_up(root: bpy.types.Object) -> np.ndarray:
    """Blender's up [3] in a capture's world."""
    return np.linalg.inv(matrix_to_numpy(root.matrix_world)[:3, :3])[:, 2]
