"""Operators of depth maps: predict, check, cancel, look at."""

from typing import ClassVar

import bpy
from bpy.props import BoolProperty, StringProperty

from .. import preferences
from ..core import GsError
from ..interface.questions import Asking
from ..process import beat
from ..render.operators import show_image
from . import job as depth_job
from . import work
from .job import DepthJob

Result = set[str]


class _DepthWork:
    """What the operators that start something share."""

    bl_options: ClassVar = {"REGISTER"}

    wait: BoolProperty(
        name="Wait",
        description="Return when it has ended; for scripts",
        options={"HIDDEN", "SKIP_SAVE"},
    )

    def execute(self, context: bpy.types.Context) -> Result:
        try:
            job = self.start(context.scene)
        except (GsError, ValueError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if not job.ended:
            return {"FINISHED"}
        failed = job.status == depth_job.FAILED
        self.report({"ERROR" if failed else "INFO"}, job.sentence)
        return {"CANCELLED" if failed else "FINISHED"}

    def start(self, scene: bpy.types.Scene) -> DepthJob:
        raise NotImplementedError


class PredictDepth(Asking, _DepthWork, bpy.types.Operator):
    """Predict depth maps of all photos with a network, in the background; Blender stays free"""

    bl_idname = "gscore.predict_depth"
    bl_label = "Predict Depth Maps"

    filepath: StringProperty(
        name="Network",
        description="ONNX file of the network; empty: the one of the preferences",
        subtype="FILE_PATH",
        options={"SKIP_SAVE"},
    )
    confirm = "Predict Anew"
    filter_glob: StringProperty(default="*.onnx", options={"HIDDEN"})
    overwrite: BoolProperty(
        name="All Anew",
        description="Replace maps that are there; else only photos without one are predicted",
        options={"SKIP_SAVE"},
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> Result:
        """Ask for a network where none is chosen, else before maps are replaced."""
        if not (self.filepath or preferences.get().depth_model.strip()):
            context.window_manager.fileselect_add(self)
            return {"RUNNING_MODAL"}
        return super().invoke(context, event)

    def question(self, context: bpy.types.Context) -> list[str]:
        """Name the maps that are replaced."""
        return work.replaced(context.scene) if self.overwrite else []

    def start(self, scene: bpy.types.Scene) -> DepthJob:
        """Start, and remember the network."""
        chosen = self.filepath
        job = work.predict(scene, chosen, overwrite=self.overwrite, wait=self.wait)
        if chosen:
            preferences.get().depth_model = chosen
        return job


class CheckDepth(_DepthWork, bpy.types.Operator):
    """Compare the depth maps with the SfM points, as a training does; writes nothing"""

    bl_idname = "gscore.check_depth"
    bl_label = "Check Maps"

    def start(self, scene: bpy.types.Scene) -> DepthJob:
        """Start."""
        return work.check(scene, wait=self.wait)


class CancelDepth(bpy.types.Operator):
    """End the work on depth maps; maps that are made stay, and the next prediction goes on"""

    bl_idname = "gscore.cancel_depth"
    bl_label = "Cancel"

    def execute(self, context: bpy.types.Context) -> Result:
        """Ask it to end."""
        job = work.job_of(context.scene)
        if job is None or job.ended:
            self.report({"ERROR"}, "No depth maps are worked on.")
            return {"CANCELLED"}
        job.cancel()
        beat.redraw()
        return {"FINISHED"}


class ShowDepthSheet(bpy.types.Operator):
    """Show photos and depth maps side by side in an image editor, in a new window if need be"""

    bl_idname = "gscore.show_depth_sheet"
    bl_label = "Contact Sheet"

    def execute(self, context: bpy.types.Context) -> Result:
        """Load it anew and show it."""
        try:
            path = work.sheet(context.scene)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        image = bpy.data.images.load(str(path), check_existing=True)
        image.reload()
        if not show_image(context, image, new_window=True):
            self.report({"INFO"}, f"{image.name} is loaded; there is no window to show it in.")
        return {"FINISHED"}


CLASSES = (PredictDepth, CheckDepth, CancelDepth, ShowDepthSheet)


def register() -> None:
    """Register the operators."""
    for cls in CLASSES:
        bpy.utils.register_class(cls)


def unregister() -> None:
    """Take them back."""
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
