"""SfM operators: choose photos or a video, find cameras, cancel."""

from pathlib import Path

import bpy
from bpy.props import StringProperty

from ..core import VIDEO_ENDINGS
from ..interface.base_operator import OnScene
from ..interface.incremental_operator import IncrementalOperator
from ..interface.sidebar import choose_tab, in_turn, open_sidebar
from ..paths import relative
from ..process.incremental_tasks import Steps
from ..training.verb_jobs import Cancelling, Waiting, ended
from . import find_cameras


class ChooseVideo(OnScene, bpy.types.Operator):
    """Choose a video filmed around the subject; its sharp frames become the photos"""

    bl_idname = "gscore.choose_video"
    bl_label = "Choose Video"

    filepath: StringProperty(
        name="Video",
        description="File of the video",
        subtype="FILE_PATH",
        options={"SKIP_SAVE"},
    )
    directory: StringProperty(
        name="Folder", description="Folder of photos", subtype="DIR_PATH", options={"SKIP_SAVE"}
    )
    filter_glob: StringProperty(
        default=";".join(f"*{end}" for end in VIDEO_ENDINGS), options={"HIDDEN"}
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser, unless a file was dropped."""
        if self.filepath:
            return self.execute(context)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def run(self, context: bpy.types.Context) -> None:
        """Choose the video, and show the panel."""
        chosen = Path(bpy.path.abspath(self.filepath or self.directory))
        if not chosen.exists():
            raise ValueError(f"There is no video {chosen}; choose a file.")
        context.scene.gscore.capture_path = relative(chosen.absolute())
        if context.area is not None and context.area.type == "VIEW_3D":  # a file was dropped on it
            in_turn(context.area, open_sidebar, choose_tab)


class FindCameras(Waiting, IncrementalOperator, OnScene, bpy.types.Operator):
    """Find the camera of each photo by structure from motion, in the background.
    From a video, sharp frames are extracted first"""

    bl_idname = "gscore.find_cameras"
    bl_label = "Find Cameras"

    def steps(self, context: bpy.types.Context) -> Steps[str]:
        """Start the job, or import an earlier result."""
        scene = context.scene
        where = find_cameras.places(scene)
        if where.exists:
            self.warn((yield from find_cameras.importing_capture(scene, where.capture)))
            return "Imported the cameras of an earlier search."
        return ended(find_cameras.find(scene, where, wait=self.wait))


class CancelSearch(Cancelling, bpy.types.Operator):
    """Cancel the search; its results are kept, and Find Cameras continues from there"""

    bl_idname = "gscore.cancel_search"
    bl_label = "Cancel"
    none = "No search for cameras is running."
    job_of = staticmethod(find_cameras.job_of)


class VideoHandler(bpy.types.FileHandler):
    """Choose a video that is dropped on a 3D view"""

    bl_idname = "GSCORE_FH_video"
    bl_label = "Video for Splats"
    bl_import_operator = "gscore.choose_video"
    bl_file_extensions = ";".join(VIDEO_ENDINGS)

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        """True in 3D views."""
        return context.area is not None and context.area.type == "VIEW_3D"
