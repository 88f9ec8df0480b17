"""Camera path operators: export of the scene camera's animation, import of a path."""

from typing import ClassVar

import bpy
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ExportHelper, ImportHelper

from ..interface.base_operator import OnScene
from ..interface.incremental_operator import IncrementalOperator
from ..paths import absolute
from ..process.incremental_tasks import Steps
from .camera_path import CAMERAS, NERFSTUDIO, TRANSFORMS, exporting_path
from .camera_path_import import importing_path, use_path
from .captures import activate
from .lookup import OnCapture, find_root, roots_of

_BLENDER = ("BLENDER", "Blender", "Blender's world: z up, as aligned and scaled")


class ExportCameraPath(IncrementalOperator, OnCapture, bpy.types.Operator, ExportHelper):
    """Export the scene camera's animation as a file with one camera per frame"""

    bl_idname = "gscore.export_camera_path"
    bl_label = "Export Camera Path"
    bl_options: ClassVar[set[str]] = {"REGISTER"}

    filename_ext = ".json"
    filter_glob: StringProperty(default="*.json", options={"HIDDEN"})
    kind: EnumProperty(
        name="Format",
        items=(
            (CAMERAS, "cameras.json", "For gscore render and 3DGS viewers; without times"),
            (
                TRANSFORMS,
                "transforms.json",
                "For gscore render and others, with times from 0 to 1 and the frame rate",
            ),
            (
                NERFSTUDIO,
                "camera_path.json",
                "For nerfstudio's viewer, ns-render and gscore render; without lens shift. By "
                "default nerfstudio rotates and scales captures",
            ),
        ),
        description="File format",
    )
    world: EnumProperty(
        name="World",
        items=(
            ("CAPTURE", "Capture", "Coordinates of the capture's files and of its splat files"),
            _BLENDER,
        ),
        description="Axes, origin and scale of the exported cameras",
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for the file."""
        return ExportHelper.invoke(self, context, event)

    def steps(self, context: bpy.types.Context) -> Steps[str]:
        """Read the frames, then write in a thread."""
        path, camera = absolute(self.filepath, "File"), context.scene.camera
        if camera is None:
            raise ValueError("The scene has no camera. Make one the scene camera and animate it.")
        root = find_root(context, self.capture) if self.world == "CAPTURE" else None
        name = camera.name
        count = yield from exporting_path(path, camera, context.scene, root=root, kind=self.kind)
        return f"{path}: {count} frames of {name}"


class ImportCameraPath(IncrementalOperator, OnCapture, OnScene, bpy.types.Operator, ImportHelper):
    """Create an animated camera from a file with one camera per frame: a cameras.json, the
    camera_path.json of nerfstudio's viewer, or a transforms.json"""

    bl_idname = "gscore.import_camera_path"
    bl_label = "Import Camera Path"

    filename_ext = ".json"
    filter_glob: StringProperty(default="*.json", options={"HIDDEN"})
    world: EnumProperty(
        name="World",
        items=(
            ("CAPTURE", "Capture", "Coordinates of the capture's files"),
            _BLENDER,
        ),
        description="Axes, origin and scale of the file",
    )
    numbered: BoolProperty(
        name="Frames from Names",
        description="Use increasing numbers at the end of the cameras' names as timeline frames, "
        "in place of Start",
        default=True,
    )
    start: IntProperty(
        name="Start", description="Frame of the first camera; the others follow", default=1
    )
    set_up_scene: BoolProperty(
        name="Set Up Scene",
        description="Make it the scene camera, with the file's resolution, range and frame rate",
        default=True,
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for the file."""
        if not self.properties.is_property_set("world") and not roots_of(context.scene):
            self.world = "BLENDER"
        return ImportHelper.invoke(self, context, event)

    def steps(self, context: bpy.types.Context) -> Steps[str]:
        """Read the file in a thread, then create the camera."""
        path = absolute(self.filepath, "File")
        root = find_root(context, self.capture) if self.world == "CAPTURE" else None
        options = {"root": root, "start": self.start, "numbered": self.numbered}
        set_up_scene = self.set_up_scene
        made = yield from importing_path(path, context.scene, **options)
        if set_up_scene:
            use_path(made.scene, made)
        activate(made.scene, made.camera)
        self.warn(made.warnings)
        first, last = made.frames
        return f"{made.camera.name}: {made.count} cameras, frames {first} to {last}"


def _draw_import(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    self.layout.operator(ImportCameraPath.bl_idname, text="Camera Path (.json)")


APPENDED = ((bpy.types.TOPBAR_MT_file_import, _draw_import),)
