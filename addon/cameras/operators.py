"""Capture operators: import, export, relocation of photos, and views through their cameras."""

from collections.abc import Iterable
from typing import Any, ClassVar

import bpy
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty

from ..interface.base_operator import Browsing, OnScene, browse
from ..interface.incremental_operator import IncrementalOperator
from ..paths import absolute
from ..process.incremental_tasks import Steps
from . import captures
from .captures import choose
from .export_colmap import exporting_colmap
from .export_transforms import exporting_transforms
from .export_views import Tracked
from .importing import importing
from .lookup import OnCapture, find_camera, find_root
from .objects import cameras_of


class ImportCameras(IncrementalOperator, OnScene, bpy.types.Operator):
    """Import a capture's cameras, photos and SfM points. An imported capture is updated from its
    files; alignment and splats stay"""

    bl_idname = "gscore.import_cameras"
    bl_label = "Import Cameras"

    directory: StringProperty(
        name="Capture",
        subtype="DIR_PATH",
        description="Folder with the COLMAP model and the photos, or with a transforms.json; "
        "empty: the folder of the Capture panel",
        options={"SKIP_SAVE"},
    )
    images: StringProperty(
        name="Photos",
        default="images",
        description="Folder of the photos inside the capture",
    )
    photos: BoolProperty(
        name="Photos as Backgrounds",
        default=True,
        description="Show each photo as the background of its camera; it is read when first drawn",
    )
    points: BoolProperty(
        name="SfM Points", default=True, description="Create an object with the colored points"
    )
    align: BoolProperty(
        name="Align to Ground",
        default=True,
        description="Rotate the capture upright and put its ground at height 0; off: keep COLMAP's "
        "axes",
    )
    set_up_views: BoolProperty(
        name="Set Up Views",
        default=True,
        description="Show the points' colors in Solid shading of 3D views, and hide outlines and "
        "the lines from each camera to its capture",
    )

    capture: StringProperty(
        name="Update Capture",
        description="Name of the empty of the capture to update; empty: a capture of the same "
        "folder",
        options={"HIDDEN", "SKIP_SAVE"},
    )
    browse: BoolProperty(
        name="Browse",
        description="Open the file browser even if the Capture panel names a folder",
        options={"HIDDEN", "SKIP_SAVE"},
    )

    @classmethod
    def description(cls, context: bpy.types.Context, properties: Any) -> str:
        """Tooltip of the menu, and of the panel."""
        if properties.browse:
            return (
                "Import the cameras, photos and SfM points of a folder with a COLMAP model and its "
                "photos, a transforms.json, or cameras of RealityScan, Metashape or OpenSfM"
            )
        return cls.__doc__ or ""

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser if the panel names no folder."""
        if not self.browse and (self.directory or _panel_path(context)):
            return self.execute(context)
        if not self.directory and (path := _panel_path(context)):
            self.directory = bpy.path.abspath(path)
        return browse(context, self)

    def steps(self, context: bpy.types.Context) -> Steps[str]:
        """Read the capture in a thread, then create its objects."""
        scene = context.scene
        path = absolute(self.directory or _panel_path(context), "Capture")
        images = self.images
        if not self.properties.is_property_set("images"):
            images = scene.gscore.images
        choices = {name: getattr(self, name) for name in ("photos", "points", "align")}
        set_up_views = self.set_up_views
        into = find_root(context, self.capture) if self.capture else None
        made = yield from importing(scene, path, images=images, into=into, **choices)
        choose(made.scene, made, set_up_views=set_up_views)
        self.warn(made.warnings)
        count = f"{len(made.cameras)} cameras"
        points = f", {len(made.points.data.vertices):,} points" if made.points else ""
        again = ", updated from its files" if made.renewed else ""
        return f"{made.root.name}: {count}{points}{again}"


class RelinkCapture(Browsing, OnCapture, bpy.types.Operator):
    """Choose the folder of a capture's photos after it or this file was moved"""

    bl_idname = "gscore.relink_capture"
    bl_label = "Find Photos"

    directory: StringProperty(
        name="Folder",
        subtype="DIR_PATH",
        description="Folder of the capture, or of its photos",
        options={"SKIP_SAVE"},
    )
    images: StringProperty(
        name="Photos",
        default="images",
        description="Folder of the photos inside the capture",
    )

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """The capture and its cameras, with their photo properties."""
        root = find_root(context, self.capture)
        obs = cameras_of(root)
        return (root, *obs, *(ob.data for ob in obs))

    def run(self, context: bpy.types.Context) -> str:
        """Relink."""
        folder = absolute(self.directory, "Folder")
        root = find_root(context, self.capture)
        found, total = captures.relink(root, folder, self.images)
        text = f"{found} of {total} photos found in {folder}"
        if found == total:
            return text
        self.warn([text])
        return ""


class ExportCameras(Browsing, IncrementalOperator, OnCapture, bpy.types.Operator):
    """Export cameras and SfM points as a COLMAP model or a transforms.json"""

    bl_idname = "gscore.export_cameras"
    bl_label = "Export Cameras"
    bl_options: ClassVar[set[str]] = {"REGISTER"}

    directory: StringProperty(
        name="Folder",
        subtype="DIR_PATH",
        description="Output folder; receives sparse/0 with a COLMAP model, or transforms.json",
        options={"SKIP_SAVE"},
    )
    kind: EnumProperty(
        name="Format",
        items=(
            ("COLMAP", "COLMAP", "cameras.bin, images.bin and points3D.bin in sparse/0"),
            ("COLMAP_TEXT", "COLMAP Text", "cameras.txt, images.txt and points3D.txt in sparse/0"),
            ("TRANSFORMS", "transforms.json", "For nerfstudio and compatible programs"),
        ),
        description="File format",
    )
    which: EnumProperty(
        name="Cameras",
        items=(
            ("CAPTURE", "Capture", "All cameras of the capture"),
            ("SELECTED", "Selected", "The selected cameras, with or without a photo"),
            ("SCENE", "Scene", "All cameras of the scene"),
        ),
        description="Cameras to export",
    )
    world: EnumProperty(
        name="World",
        items=(
            ("CAPTURE", "Capture", "Coordinates of the capture's files, without the alignment"),
            ("BLENDER", "Blender", "Blender's world: z up, as aligned and scaled; without points"),
        ),
        description="Axes, origin and scale of the exported cameras",
    )

    def steps(self, context: bpy.types.Context) -> Steps[str]:
        """Read cameras and points, then write in a thread."""
        folder = absolute(self.directory, "Folder")
        needs_root = self.world == "CAPTURE" or self.which == "CAPTURE"
        root = find_root(context, self.capture) if needs_root else None
        obs = _chosen(context, self.which, root)
        world = root if self.world == "CAPTURE" else None
        tracked = Tracked(obs, context.scene, world, context.evaluated_depsgraph_get)
        if self.kind == "TRANSFORMS":
            work = exporting_transforms(folder / "transforms.json", tracked)
        else:
            work = exporting_colmap(folder, tracked, binary=self.kind == "COLMAP")
        done = yield from work
        self.warn(done.warnings)
        moved = f", {done.moved} of them as moved in Blender" if done.moved else ""
        return f"{done.path}: {done.views:,} cameras{moved}, {done.points:,} points"


_shown: list[tuple[str, str, str]] = []
"""Items of the last search, kept because Blender does not copy their strings."""


def _image_items(self: Any, context: bpy.types.Context | None) -> list[tuple[str, str, str]]:
    """The photos of the operator's capture."""
    try:
        listed = cameras_of(find_root(context, self.capture)) if context else []
    except ValueError:
        listed = []
    names = [str(ob.get("gs_image", ob.name)) for ob in listed]
    _shown[:] = [(name, name, "") for name in dict.fromkeys(names)] or [("NONE", "No photo", "")]
    return _shown


class UseCamera(OnScene, OnCapture, bpy.types.Operator):
    """Look through a photo's camera; sets the scene camera, resolution and pixel aspect"""

    bl_idname = "gscore.use_camera"
    bl_label = "Use Camera"

    camera: StringProperty(
        name="Camera",
        description="Name of the camera or of its photo; empty: by index",
        options={"SKIP_SAVE"},
    )
    index: IntProperty(
        name="Index",
        default=-1,
        min=-1,
        description="Index of the photo in the order of names, from 0; -1: the active camera, else "
        "the scene camera, else the first",
        options={"SKIP_SAVE"},
    )
    look_through: BoolProperty(
        name="Look Through", default=True, description="Turn the 3D view to the camera"
    )

    def run(self, context: bpy.types.Context) -> None:
        """Set the camera, and look through it."""
        root = find_root(context, self.capture)
        ob = find_camera(context, root, self.camera, self.index)
        self.warn(captures.use_camera(context.scene, ob))
        if self.look_through:
            _look_through(context)


class StepCamera(OnScene, OnCapture, bpy.types.Operator):
    """Look through the next or the previous photo's camera"""

    bl_idname = "gscore.step_camera"
    bl_label = "Next Camera"

    step: IntProperty(name="Step", default=1, description="Photos to advance; negative: backwards")
    look_through: BoolProperty(
        name="Look Through", default=True, description="Turn the 3D view to the camera"
    )

    @classmethod
    def description(cls, context: bpy.types.Context, properties: Any) -> str:
        """Tooltip by direction."""
        which = "next" if properties.step > 0 else "previous"
        return f"Look through the {which} photo's camera"

    def run(self, context: bpy.types.Context) -> None:
        """Step."""
        ob = captures.step_camera(context.scene, find_root(context, self.capture), self.step)
        self.warn(captures.use_camera(context.scene, ob))
        if self.look_through:
            _look_through(context)


class ChooseCamera(OnScene, OnCapture, bpy.types.Operator):
    """Search for a photo by name and look through its camera"""

    bl_idname = "gscore.choose_camera"
    bl_label = "Choose Photo"
    bl_property = "image"

    image: EnumProperty(
        name="Photo",
        items=_image_items,
        description="Name of the photo",
        options={"SKIP_SAVE"},
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the search."""
        context.window_manager.invoke_search_popup(self)
        return {"RUNNING_MODAL"}

    def run(self, context: bpy.types.Context) -> None:
        """Set the camera, and look through it."""
        ob = find_camera(context, find_root(context, self.capture), self.image)
        self.warn(captures.use_camera(context.scene, ob))
        _look_through(context)


def _look_through(context: bpy.types.Context) -> None:
    """Turn one 3D view to the camera, unless one shows it already."""
    areas = context.screen.areas if context.screen else []
    regions = [area.spaces.active.region_3d for area in areas if area.type == "VIEW_3D"]
    if regions and all(region.view_perspective != "CAMERA" for region in regions):
        space = context.space_data
        own = getattr(space, "region_3d", None) if space and space.type == "VIEW_3D" else None
        (own or regions[0]).view_perspective = "CAMERA"


def _draw_import(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    text = "COLMAP or NeRF Cameras (capture folder)"
    self.layout.operator(ImportCameras.bl_idname, text=text).browse = True


def _panel_path(context: bpy.types.Context) -> str:
    return context.scene.gscore.capture_path.strip()


def _chosen(
    context: bpy.types.Context, which: str, root: bpy.types.Object | None
) -> list[bpy.types.Object]:
    if which == "CAPTURE" and root is not None:
        return cameras_of(root)
    source = context.selected_objects if which == "SELECTED" else context.scene.objects
    return sorted((ob for ob in source if ob.type == "CAMERA"), key=lambda ob: ob.name)


APPENDED = ((bpy.types.TOPBAR_MT_file_import, _draw_import),)
