"""Camera path operators: export of the scene camera's animation, import of a path."""

from collections.abc import Iterable
from typing import ClassVar

import bpy
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty
from bpy_extras.io_utils import ExportHelper, ImportHelper

from ..interface.incremental_operator import IncrementalOperator
from ..paths import absolute
from ..process.incremental_tasks import Pieces
from .camera_path import CAMERAS, NERFSTUDIO, TRANSFORMS, exporting_path
from .camera_path_import import importing_path, use_path
from .lookup import find_root, roots_of
from .operators import OnCapture
from .select_imported import activate

_BLENDER = ("BLENDER", "Blender", "Blender's world: z up, as aligned and scaled")


class ExportCameraPath(IncrementalOperator, OnCapture, bpy.types.Operator, ExportHelper):
    """Write the scene camera's animation as a file with a camera for each frame"""

    bl_idname = "gscore.export_camera_path"
    bl_label = "Export Camera Path"
    bl_options: ClassVar[set[str]] = {"REGISTER"}

    filename_ext = ".json"
    filter_glob: StringProperty(default="*.json", options={"HIDDEN"})
    kind: EnumProperty(
        name="Files",
        items=(
            (CAMERAS, "cameras.json", "For gscore render and viewers of 3DGS; has no times"),
            (
                TRANSFORMS,
                "transforms.json",
                "For gscore render and others, with times from 0 to 1 and frames a second",
            ),
            (
                NERFSTUDIO,
                "camera_path.json",
                "For nerfstudio's viewer and ns-render, and gscore render; without lens shift. "
                "nerfstudio turns and scales captures, unless it is told not to",
            ),
        ),
        description="What to write",
    )
    world: EnumProperty(
        name="World",
        items=(
            ("CAPTURE", "Capture", "The world of the capture's own files, where its splats lie"),
            _BLENDER,
        ),
        description="Whose axes, origin and scale to write in",
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for the file."""
        return ExportHelper.invoke(self, context, event)

    def pieces(self, context: bpy.types.Context) -> Pieces[str]:
        """Read the frames, then write in a thread."""
        path, camera = absolute(self.filepath, "File"), context.scene.camera
        if camera is None:
            raise ValueError("The scene has no camera. Make one the scene camera and animate it.")
        root = find_root(context, self.capture) if self.world == "CAPTURE" else None
        name, given = camera.name, {"root": root, "kind": self.kind}
        count = yield from exporting_path(path, camera, context.scene, **given)
        return f"{path}: {count} frames of {name}"


class ImportCameraPath(IncrementalOperator, OnCapture, bpy.types.Operator, ImportHelper):
    """Make an animated camera of a file with a camera for each frame: a cameras.json, the
    camera_path.json of nerfstudio's viewer, or a transforms.json"""

    bl_idname = "gscore.import_camera_path"
    bl_label = "Import Camera Path"

    filename_ext = ".json"
    filter_glob: StringProperty(default="*.json", options={"HIDDEN"})
    world: EnumProperty(
        name="World",
        items=(
            ("CAPTURE", "Capture", "The file is in the world of the capture's own files"),
            _BLENDER,
        ),
        description="Whose axes, origin and scale the file has",
    )
    numbered: BoolProperty(
        name="As Numbered",
        description="Where the cameras' names end with numbers that rise, take these as frames of "
        "the timeline, whatever Start says",
        default=True,
    )
    start: IntProperty(
        name="Start", description="Frame of the first camera; the others follow", default=1
    )
    set_up_scene: BoolProperty(
        name="Set Up Scene",
        description="Render through this camera, at the size, range and pace of the file",
        default=True,
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Ask for the file."""
        if not self.properties.is_property_set("world") and not roots_of(context.scene):
            self.world = "BLENDER"
        return ImportHelper.invoke(self, context, event)

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """The scene."""
        return (context.scene,)

    def pieces(self, context: bpy.types.Context) -> Pieces[str]:
        """Read it in a thread, then make the camera."""
        path = absolute(self.filepath, "File")
        root = find_root(context, self.capture) if self.world == "CAPTURE" else None
        given = {"root": root, "start": self.start, "numbered": self.numbered}
        set_up_scene = self.set_up_scene
        made = yield from importing_path(path, context.scene, **given)
        if set_up_scene:
            use_path(made.scene, made)
        activate(made.scene, made.camera)
        self.warn(made.warnings)
        first, last = made.frames
        return f"{made.camera.name}: {made.count} cameras, frames {first} to {last}"


CLASSES = (ExportCameraPath, ImportCameraPath)


def _draw_import(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    self.layout.operator(ImportCameraPath.bl_idname, text="Camera Path (.json)")


def on_register() -> None:
    """Add the entry of File > Import."""
    bpy.types.TOPBAR_MT_file_import.append(_draw_import)


def on_unregister() -> None:
    """Take it back."""
    bpy.types.TOPBAR_MT_file_import.remove(_draw_import)
