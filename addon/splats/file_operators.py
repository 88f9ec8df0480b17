"""File operators of splats: import, export, their menus, and drag and drop."""

from pathlib import Path
from typing import ClassVar

import bpy
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    IntProperty,
    StringProperty,
)
from bpy_extras.io_utils import ExportHelper, ImportHelper

from ..cameras.lookup import root_of_run
from ..cameras.objects import root_of
from ..core import LOD_ENDING, SPLAT_ENDINGS, count_text
from ..interface.base_operator import Condition, OnScene, make_active
from ..interface.incremental_operator import IncrementalOperator
from ..paths import chosen_file
from ..process.incremental_tasks import Steps
from . import exporting, splat_files, splat_framing
from .importing import importing_splats
from .objects import active_splats, can_export, hide_points, is_splats

_GLOB = ";".join(f"*{ending}" for ending in SPLAT_ENDINGS)
_ENDINGS = [
    (".ply", "PLY", "Official 3DGS format, lossless"),
    (".compressed.ply", "Compressed PLY", "Format of SuperSplat, a quarter of the size"),
    (".spz", "SPZ", "Format of Niantic, a fifth of the size"),
    (".sog", "SOG", "Format of PlayCanvas, an eighth of the size"),
    (".splat", "splat", "32 bytes per splat for small viewers, without view-dependent color"),
    (".glb", "glTF", "KHR_gaussian_splatting, complete, as floats"),
    (".spz.glb", "glTF with SPZ", "KHR_gaussian_splatting, packed as SPZ"),
    (".usdc", "USD", "ParticleField3DGaussianSplat; the Python that trains needs usd-core 26.03"),
]
_DROPPED = ";".join(sorted({ending[ending.rindex(".") :] for ending in SPLAT_ENDINGS} - {".json"}))
"""Extensions for drag and drop. Blender lets the user choose among several importers, as for glTF
and USD."""
AXIS_ITEMS = [
    ("-Y", "-Y Up", "The file's +Y points down, as COLMAP and most trainers write it"),
    ("Y", "+Y Up", "The file's +Y points up"),
    ("Z", "+Z Up", "The file's +Z points up, as in Blender"),
]
_UP_ITEMS = [
    (
        splat_files.FROM_FILE,
        "From File",
        "Axis stated in a comment of the file, as written by gscore and nerfstudio; -Y Up without "
        "one, as in COLMAP and most trainers",
    ),
    *AXIS_ITEMS,
]
_WORLDS = [
    (
        splat_files.SOURCE,
        "Photos",
        "World of the photos' cameras (COLMAP's) or of the imported file, without the alignment of "
        "the capture or the rotation of the import",
    ),
    (splat_files.BLENDER, "Blender", "Blender's world, as displayed, +Z up"),
]


class ImportOperator(IncrementalOperator, OnScene):
    """Base of import operators, which define the files and the handling of the objects."""

    def import_requests(self, context: bpy.types.Context) -> list[splat_files.ImportRequest]:
        """Files to import; raises ValueError if there are none."""
        raise NotImplementedError

    def show(
        self, context: bpy.types.Context, made: list[bpy.types.Object], warnings: list[str]
    ) -> str:
        """Handle the objects, one per file; the text of the report."""
        raise NotImplementedError

    def steps(self, context: bpy.types.Context) -> Steps[str]:
        """Read in a thread, then write to Blender."""
        made = yield from importing_splats(context, self.import_requests(context))
        return self.show(context, made.objects, made.warnings)


class ImportSplats(ImportOperator, bpy.types.Operator, ImportHelper):
    """Import Gaussian splats from PLY, SPZ, SOG, .splat, .ksplat, glTF or USD, or a level of detail
    of a .lod file"""

    bl_idname = "gscore.import_splats"
    bl_label = "Import Splats"
    bl_options: ClassVar = {"REGISTER", "UNDO", "PRESET"}

    filename_ext = ".ply"
    filter_glob: StringProperty(default=f"{_GLOB};*{LOD_ENDING}", options={"HIDDEN"})
    files: CollectionProperty(
        type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"}
    )
    directory: StringProperty(subtype="DIR_PATH", options={"HIDDEN", "SKIP_SAVE"})
    up: EnumProperty(
        name="Up",
        description="Axis of the file that points up",
        items=_UP_ITEMS,
        default=splat_files.FROM_FILE,
    )
    under_capture: BoolProperty(
        name="Parent to Capture",
        description="Parent the splats to the capture of the active object, or to the capture they "
        "were trained on, so that they match its photos; the up axis is then the capture's",
        default=True,
    )
    level: IntProperty(
        name="Level",
        description="Level of detail to import: 0 is the finest; -1 the finest with at most "
        f"{splat_files.MOST_AT_ONCE:,} splats",
        default=-1,
        min=-1,
        max=15,
    )
    turn_views: BoolProperty(
        name="Frame in Views",
        description="Frame the imported splats in the 3D views; a photo camera of their capture "
        "replaces Blender's default as the scene camera",
        default=True,
    )
    in_crop: BoolProperty(
        name="Only in the Crop",
        description="Import only splats inside the crop box of the active splat object, which must "
        "come from the same file with levels of detail; in the finest level unless one is chosen",
        default=False,
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser, or the options for a dropped file."""
        return self.invoke_popup(context)

    def import_requests(self, context: bpy.types.Context) -> list[splat_files.ImportRequest]:
        """Requested files of the properties; raises ValueError for impossible requests."""
        paths = [Path(self.directory, file.name) for file in self.files if file.name]
        active = root_of(context.object) if self.under_capture else None
        cropped = active_splats(context) if self.in_crop else None
        if self.in_crop and not is_splats(cropped):
            raise ValueError("Select the splat object whose crop limits the import.")
        level = None if self.level < 0 else self.level
        requests = []
        for path in paths or [chosen_file(self.filepath)]:
            parent = active
            if self.under_capture and parent is None:
                parent = root_of_run(context.scene, path)
            requests.append(
                splat_files.import_request(
                    path, parent=parent, up=self.up, level=level, cropped=cropped
                )
            )
        return requests

    def show(
        self, context: bpy.types.Context, made: list[bpy.types.Object], warnings: list[str]
    ) -> str:
        """Select the imported objects; the text of the report."""
        self.warn(warnings)
        free = context.mode == "OBJECT"  # first: reading it updates the view layer's objects
        here = [ob for ob in made if ob.name in context.view_layer.objects]
        if here and free:
            make_active(context, here[-1])
            for ob in here:
                ob.select_set(True)
        for root in {root_of(ob) for ob in made} - {None}:
            hide_points(context.scene, root)
        if here and self.turn_views and not self.in_crop:
            context.view_layer.update()
            splat_framing.turn_views(context.scene, here[-1])
            self.warn(splat_framing.set_camera(context.scene, here[-1], may_add=False))
        total = sum(len(ob.data.vertices) for ob in made)
        return f"Imported {total:,} splats from {count_text(len(made), 'file')}."


class ExportSplats(IncrementalOperator, bpy.types.Operator, ExportHelper):
    """Export the selected splats with their edits and transforms as one file"""

    bl_idname = "gscore.export_splats"
    bl_label = "Export Splats"
    bl_options: ClassVar = {"REGISTER", "PRESET"}
    needs = Condition(  # collection exporters need no selection
        lambda context: any(can_export(ob) for ob in context.scene.objects),
        "There are no splats: import a splat PLY or train some",
    )

    filter_glob: StringProperty(default=_GLOB, options={"HIDDEN"})
    ending: EnumProperty(name="Format", description="File format and extension", items=_ENDINGS)
    world: EnumProperty(name="World", description="Axes and scale of the file", items=_WORLDS)
    filtered: BoolProperty(
        name="Only Visible",
        description="Leave out splats that the filters and the crop hide",
        default=True,
    )
    proxies: BoolProperty(
        name="Proxies",
        description="Write the proxies of the splats too: hidden in a glTF or USD, else beside the "
        "file, as NAME.proxy.ply, a mesh with colors at their place",
        default=False,
    )
    collection: StringProperty(
        name="Collection",
        description="Export the splat objects of this collection, not the selected ones; set by "
        "the exporters of collections",
        options={"HIDDEN", "SKIP_SAVE"},
    )

    @property
    def filename_ext(self) -> str:
        """Extension of the file browser's default name."""
        return self.ending

    def check(self, context: bpy.types.Context) -> bool:
        """Set the extension of the chosen format."""
        known = sorted((end for end, *_ in _ENDINGS), key=len, reverse=True)
        stem = next((self.filepath[: -len(e)] for e in known if self.filepath.endswith(e)), "")
        named = (stem or self.filepath) + self.ending
        changed = named != self.filepath
        self.filepath = named
        return changed

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser, unless there is nothing to export."""
        if not _chosen(context, self.collection):
            return self.refuse(ValueError("Select the splat objects to export."))
        return ExportHelper.invoke(self, context, event)

    def steps(self, context: bpy.types.Context) -> Steps[str]:
        """Write the file."""
        context.view_layer.update()
        obs, path = _chosen(context, self.collection), self.filepath
        how = {"world": self.world, "filtered": self.filtered, "proxies": self.proxies}
        count, notes = yield from exporting.exporting(obs, path, **how)
        self.warn(notes)
        return f"Wrote {count:,} splats to {path}."


def _chosen(context: bpy.types.Context, collection: str) -> list[bpy.types.Object]:
    """Objects with splats in a collection, else the active one, or the one that it crops, followed
    by the selected ones.

    Raises:
        ValueError: there is no such collection.
    """
    obs = [context.object, active_splats(context), *context.selected_objects]
    if collection:
        block = bpy.data.collections.get(collection)
        if block is None:
            raise ValueError(f"There is no collection {collection} to export.")
        obs = list(block.all_objects)
    return list(dict.fromkeys(ob for ob in obs if can_export(ob)))


class GSCORE_FH_splats(bpy.types.FileHandler):  # noqa: N801 - Blender's rule
    """Drop a file of splats into the 3D view."""

    bl_idname = "GSCORE_FH_splats"
    bl_label = "Gaussian Splats (Train Splats)"
    bl_import_operator = "gscore.import_splats"
    bl_export_operator = "gscore.export_splats"
    bl_file_extensions = _DROPPED

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        """True if the file was dropped on a 3D view."""
        return context.area is not None and context.area.type == "VIEW_3D"


def _draw_import(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    kinds = ".ply, .spz, .sog, .splat, .ksplat, .glb, .usd"
    self.layout.operator(ImportSplats.bl_idname, text=f"Gaussian Splats ({kinds})")


def _draw_export(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    kinds = ".ply, .spz, .sog, .splat, .glb, .usd"
    self.layout.operator(ExportSplats.bl_idname, text=f"Gaussian Splats ({kinds})")


APPENDED = (
    (bpy.types.TOPBAR_MT_file_import, _draw_import),
    (bpy.types.TOPBAR_MT_file_export, _draw_export),
)
