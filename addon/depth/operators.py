"""Depth map operators: predict, check, cancel, show."""

import bpy
from bpy.props import BoolProperty, StringProperty

from .. import preferences
from ..interface.base_operator import BaseOperator, ConfirmMixin
from ..interface.images import show_image
from ..training.verb_job import VerbJob
from ..training.verb_jobs import Cancelling, Starting
from . import networks, predict_depth


class PredictDepth(ConfirmMixin, Starting, bpy.types.Operator):
    """Predict depth maps of all photos with a network, in the background"""

    bl_idname = "gscore.predict_depth"
    bl_label = "Predict Depth Maps"

    filepath: StringProperty(
        name="Network",
        description="ONNX file of the network; empty: the network of the preferences",
        subtype="FILE_PATH",
        options={"SKIP_SAVE"},
    )
    confirm = "Predict Again"
    filter_glob: StringProperty(default="*.onnx", options={"HIDDEN"})
    overwrite: BoolProperty(
        name="Replace All",
        description="Replace existing maps; off: predict only photos without a map",
        options={"SKIP_SAVE"},
    )

    download: BoolProperty(
        name="Download",
        description="Download the network if it is not on this computer",
        options={"HIDDEN", "SKIP_SAVE"},
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser if no network is chosen, else confirm the replacement of maps."""
        prefs = preferences.get()
        if not (self.filepath or networks.chosen() or prefs.depth_model.strip()):
            context.window_manager.fileselect_add(self)
            return {"RUNNING_MODAL"}
        return super().invoke(context, event)

    def confirm_lines(self, context: bpy.types.Context) -> list[str]:
        """List the replaced maps and the download."""
        lines = predict_depth.replaced(context.scene) if self.overwrite else []
        network = networks.chosen()
        if self.download and network is not None:
            networks.check_download(network, True)
            self.confirm = "Download"
            lines += networks.confirm_lines(network)
        return lines

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the confirmation, or the options of the file browser."""
        super().draw(context)
        if not getattr(self, "lines", ()):
            self.layout.prop(self, "overwrite")

    def start(self, context: bpy.types.Context) -> VerbJob:
        """Start the job, and store the network in the preferences."""
        chosen = self.filepath
        job = predict_depth.predict(
            context.scene,
            chosen,
            overwrite=self.overwrite,
            download=self.download,
            wait=self.wait,
        )
        if chosen:
            preferences.get().depth_model = chosen
        return job


class CheckDepth(Starting, bpy.types.Operator):
    """Compare the depth maps with the SfM points, as a training does; no files are written"""

    bl_idname = "gscore.check_depth"
    bl_label = "Check Maps"

    def start(self, context: bpy.types.Context) -> VerbJob:
        """Start the job."""
        return predict_depth.check(context.scene, wait=self.wait)


class CancelDepth(Cancelling, bpy.types.Operator):
    """Cancel the depth job; finished maps are kept, and the next prediction continues"""

    bl_idname = "gscore.cancel_depth"
    bl_label = "Cancel"
    none = "No depth job is running."
    job_of = staticmethod(predict_depth.job_of)


class ShowDepthSheet(BaseOperator, bpy.types.Operator):
    """Show photos and depth maps side by side in an image editor"""

    bl_idname = "gscore.show_depth_sheet"
    bl_label = "Contact Sheet"

    def run(self, context: bpy.types.Context) -> str:
        """Reload the picture and show it."""
        image = bpy.data.images.load(str(predict_depth.sheet(context.scene)), check_existing=True)
        image.reload()
        if show_image(context, image, new_window=True):
            return ""
        return f"Loaded {image.name}; there is no window to show it."
