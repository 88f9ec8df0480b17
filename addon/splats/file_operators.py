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
from ..core import LOD_ENDING, SPLAT_ENDINGS
from ..interface.base_operator import make_active
from ..interface.incremental_operator import IncrementalOperator
from ..process.incremental_tasks import Pieces
from . import exporting, framed, splat_files
from .import_operator import ImportOperator
from .objects import can_export, hide_points, is_splats, meant

_GLOB = ";".join(f"*{ending}" for ending in SPLAT_ENDINGS)
_ENDINGS = [
    (".ply", "PLY", "The official 3DGS layout: everything, to the bit"),
    (".compressed.ply", "Compressed PLY", "SuperSplat's layout, a quarter of the size"),
    (".spz", "SPZ", "Niantic's layout, a fifth of the size"),
    (".sog", "SOG", "PlayCanvas' layout, an eighth of the size"),
    (".splat", "splat", "32 bytes a splat for small viewers; colors do not change with the view"),
    (".glb", "glTF", "KHR_gaussian_splatting: everything, as floats"),
    (".spz.glb", "glTF with SPZ", "KHR_gaussian_splatting, packed as SPZ"),
    (".usdc", "USD", "ParticleField3DGaussianSplat; the Python that trains needs usd-core 26.03"),
]
_DROPPED = ";".join(sorted({ending[ending.rindex(".") :] for ending in SPLAT_ENDINGS} - {".json"}))
"""Endings of files that are dropped. Blender has importers of its own for glTF and USD, so it asks
which one is meant."""
AXIS_ITEMS = [
    ("-Y", "-Y Up", "The file's +Y points down, as COLMAP and most trainers write it"),
    ("Y", "+Y Up", "The file's +Y points up"),
    ("Z", "+Z Up", "The file's +Z points up, as in Blender"),
]
_UP_ITEMS = [
    (
        splat_files.FROM_FILE,
        "As Exported",
        "The axis that a comment of the file states, as gscore and nerfstudio write it; -Y Up "
        "where none does, as COLMAP and most trainers have it",
    ),
    *AXIS_ITEMS,
]
_WORLDS = [
    (
        splat_files.SOURCE,
        "Photos",
        "The world of the photos' cameras (COLMAP's) or of the imported file: the alignment of "
        "the capture, or the turn of the import, is taken back",
    ),
    (splat_files.BLENDER, "Blender", "Blender's world, as the scene shows the splats, +Z up"),
]


class ImportSplats(ImportOperator, bpy.types.Operator, ImportHelper):
    """Import Gaussian splats of any trainer or viewer: PLY, SPZ, SOG, .splat, .ksplat, glTF, USD;
    or a level of detail of a .lod file"""

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
        name="Under the Capture",
        description="Put the splats under the capture that the active object belongs to, or whose "
        "photos they were trained on, so that they stand where these were taken; the up axis is "
        "then the capture's",
        default=True,
    )
    level: IntProperty(
        name="Level",
        description="Of a file of levels of detail, which one: 0 is the finest; -1 the finest of "
        f"{splat_files.MOST_AT_ONCE:,} splats at most",
        default=-1,
        min=-1,
        max=15,
    )
    turn_views: BoolProperty(
        name="Turn Views",
        description="Turn the 3D views to the splats that come",
        default=True,
    )
    in_crop: BoolProperty(
        name="Only in the Crop",
        description="Of a file of levels of detail, only what lies in the box of the active splat "
        "object's crop, of the finest level unless one is chosen; it is put where that object "
        "stands, which has to come from the same file",
        default=False,
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser, or the options of a file that was dropped."""
        return self.invoke_popup(context)

    def wanted(self, context: bpy.types.Context) -> list[splat_files.Wanted]:
        """Requested files of the properties; raises ValueError for impossible requests."""
        paths = [Path(self.directory, file.name) for file in self.files if file.name]
        active = root_of(context.object) if self.under_capture else None
        cropped = meant(context) if self.in_crop else None
        if self.in_crop and not is_splats(cropped):
            raise ValueError("Select the splat object whose crop says what to import.")
        level = None if self.level < 0 else self.level
        found = []
        for path in paths or [Path(self.filepath)]:
            parent = active
            if self.under_capture and parent is None:
                parent = root_of_run(context.scene, path)
            found.append(
                splat_files.want(path, parent=parent, up=self.up, level=level, cropped=cropped)
            )
        return found

    def show(
        self, context: bpy.types.Context, made: list[bpy.types.Object], warnings: list[str]
    ) -> str:
        """Select the imported objects; the text of the report."""
        self.warn(warnings)
        free = context.mode == "OBJECT"  # asked first, it has the view layer know the new objects
        here = [ob for ob in made if ob.name in context.view_layer.objects]
        if here and free:
            make_active(context, here[-1])
            for ob in here:
                ob.select_set(True)
        for root in {root_of(ob) for ob in made} - {None}:
            hide_points(context.scene, root)
        if here and self.turn_views and not self.in_crop:
            context.view_layer.update()
            framed.turn_views(context.scene, here[-1])
        total = sum(len(ob.data.vertices) for ob in made)
        return f"Imported {total:,} splats from {len(made)} file(s)."


class ExportSplats(IncrementalOperator, bpy.types.Operator, ExportHelper):
    """Export the selected splats, edited and moved as they are, as one file"""

    bl_idname = "gscore.export_splats"
    bl_label = "Export Splats"
    bl_options: ClassVar = {"REGISTER", "PRESET"}

    filter_glob: StringProperty(default=_GLOB, options={"HIDDEN"})
    ending: EnumProperty(
        name="Format", description="What the name of the file ends in", items=_ENDINGS
    )
    world: EnumProperty(name="World", description="Axes and scale of the file", items=_WORLDS)
    filtered: BoolProperty(
        name="Only Visible",
        description="Leave out splats that the filters and the crop hide",
        default=True,
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

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """True if any object has splats; collection exporters need no selection."""
        if any(can_export(ob) for ob in context.scene.objects):
            return True
        cls.poll_message_set("There are no splats: import a splat PLY or train some")
        return False

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Open the file browser, unless there is nothing to write."""
        if not _chosen(context, self.collection):
            return self.refuse(ValueError("Select the splat objects to export."))
        return ExportHelper.invoke(self, context, event)

    def pieces(self, context: bpy.types.Context) -> Pieces[str]:
        """Write the file."""
        context.view_layer.update()
        obs, path = _chosen(context, self.collection), self.filepath
        how = {"world": self.world, "filtered": self.filtered}
        count, notes = yield from exporting.exporting(obs, path, **how)
        self.warn(notes)
        return f"Wrote {count:,} splats to {path}."


def _chosen(context: bpy.types.Context, collection: str) -> list[bpy.types.Object]:
    """Objects with splats of a collection, else the active one, or the one that the active crops,
    and then those selected.

    Raises:
        ValueError: there is no such collection.
    """
    obs = [context.object, meant(context), *context.selected_objects]
    if collection:
        found = bpy.data.collections.get(collection)
        if found is None:
            raise ValueError(f"There is no collection {collection} to export.")
        obs = list(found.all_objects)
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


CLASSES = (ImportSplats, ExportSplats, GSCORE_FH_splats)


def _draw_import(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    kinds = ".ply, .spz, .sog, .splat, .ksplat, .glb, .usd"
    self.layout.operator(ImportSplats.bl_idname, text=f"Gaussian Splats ({kinds})")


def _draw_export(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    kinds = ".ply, .spz, .sog, .splat, .glb, .usd"
    self.layout.operator(ExportSplats.bl_idname, text=f"Gaussian Splats ({kinds})")


def on_register() -> None:
    """Add the entries of File > Import and Export."""
    bpy.types.TOPBAR_MT_file_import.append(_draw_import)
    bpy.types.TOPBAR_MT_file_export.append(_draw_export)


def on_unregister() -> None:
    """Remove the entries."""
    bpy.types.TOPBAR_MT_file_export.remove(_draw_export)
    bpy.types.TOPBAR_MT_file_import.remove(_draw_import)
