"""Sequence operators: import, resume after an edit, keep a frame, reload the folder."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import ClassVar

import bpy
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty

from ..cameras.lookup import find_root
from ..cameras.objects import root_of
from ..core import SPLAT_ENDINGS
from ..interface import editable_check
from ..interface.base_operator import Browsing, Condition, OnScene, Undoable, make_active
from ..interface.incremental_operator import IncrementalOperator
from ..paths import relative
from ..process import poll_timer
from ..process.incremental_tasks import Steps
from ..splats import splat_files
from ..splats.file_operators import AXIS_ITEMS
from ..splats.importing import importing_splats
from ..splats.objects import active_splats, has_splats, hide_points
from ..splats.splat_files import ImportRequest
from . import frame_sync, mesh
from .frame_at import folder_of, moment_of
from .frames import Series, find_series, name_of_file
from .library import LIBRARY
from .settings import is_sequence


class OnSequence(Undoable):
    """Base of operators on the active splat object with a sequence."""

    needs = Condition(
        lambda context: has_splats(context) and is_sequence(active_splats(context)),
        "Select a splat object that plays a sequence",
    )


class ImportSequence(Browsing, IncrementalOperator, OnScene, bpy.types.Operator):
    """Import a folder of numbered splat files, or the output of gscore sequence, as one object that
    plays on the timeline"""

    bl_idname = "gscore.import_sequence"
    bl_label = "Import Splat Sequence"
    given = ("directory", "filepath")

    filepath: StringProperty(
        name="Frame",
        description="One of the frames, if the folder has several kinds of files",
        subtype="FILE_PATH",
        options={"SKIP_SAVE"},
    )
    directory: StringProperty(
        name="Folder",
        description="Folder of the frames",
        subtype="DIR_PATH",
        options={"SKIP_SAVE"},
    )
    filter_glob: StringProperty(
        default=";".join(f"*{ending}" for ending in SPLAT_ENDINGS), options={"HIDDEN"}
    )
    capture: StringProperty(
        name="Capture",
        description="Name of the capture's empty to parent the splats to; empty: as below",
        options={"HIDDEN", "SKIP_SAVE"},
    )
    start: IntProperty(
        name="Start",
        description="Frame of the timeline that shows the first frame of the sequence",
        default=1,
    )
    set_range: BoolProperty(
        name="Set Scene Range",
        description="Set the start and end frame of the scene to those of the sequence",
        default=False,
    )
    up: EnumProperty(
        name="Up", description="Axis of the files that points up", items=AXIS_ITEMS, default="-Y"
    )
    under_capture: BoolProperty(
        name="Parent to Capture",
        description="Parent the splats to the capture of the active object, to align them with its "
        "cameras. The up axis is then the capture's",
        default=True,
    )

    def steps(self, context: bpy.types.Context) -> Steps[str]:
        """Find the frames and read the first in a thread, then write it to Blender."""
        folder, called = self._chosen()
        parent = root_of(context.object) if self.under_capture else None
        if self.capture:
            parent = find_root(context, self.capture)
        options = {"called": called, "start": self.start, "parent": parent, "up": self.up}
        made = yield from importing_sequence(context, folder, **options)
        return self._finish(context, *made)

    def _finish(
        self,
        context: bpy.types.Context,
        ob: bpy.types.Object,
        series: Series,
        warnings: list[str],
    ) -> str:
        self.warn(warnings)
        if series.gaps:
            self.warn([series.gap_text()])
        free = context.mode == "OBJECT"  # reading the mode first updates the view layer
        if free and ob.name in context.view_layer.objects:
            make_active(context, ob)
        if (root := root_of(ob)) is not None:
            hide_points(context.scene, root)
        if self.set_range:
            context.scene.frame_start = max(self.start, 0)
            context.scene.frame_end = max(self.start + series.slots - 1, 0)
        poll_timer.ensure()
        first, last = series.files[0].number, series.files[-1].number
        return f"Imported {len(series.files):,} frames, {first} to {last}."

    def _chosen(self) -> tuple[Path, str]:
        """The folder, and the name pattern of its frames."""
        path = Path(bpy.path.abspath(self.filepath)) if self.filepath else None
        if path is not None and path.is_file() and path.name != "sequence.json":
            return name_of_file(path)
        folder = Path(bpy.path.abspath(self.directory)) if self.directory else path
        if folder is None:
            raise ValueError("No folder is chosen: choose the folder of the frames.")
        if folder.name == "sequence.json" or not (folder.suffix == "" or folder.is_dir()):
            folder = folder.parent
        return Path(folder.absolute()), ""


class PlayAgain(OnSequence, bpy.types.Operator):
    """Discard the edits of the current frame and resume playback"""

    bl_idname = "gscore.play_again"
    bl_label = "Discard Edits and Play"

    def changes(self, context: bpy.types.Context) -> Iterable[bpy.types.ID]:
        """Its points and playback state."""
        ob = active_splats(context)
        return ob.data, ob

    def run(self, context: bpy.types.Context) -> None:
        """Resume playback."""
        ob = active_splats(context)
        mesh.forget(ob.data)
        ob.gscore_sequence.edited = False
        frame_sync.settings_changed(ob)


class KeepFrame(OnSequence, bpy.types.Operator):
    """Make a separate object from the current frame, for editing or export"""

    bl_idname = "gscore.keep_frame"
    bl_label = "Keep This Frame"

    def run(self, context: bpy.types.Context) -> str:
        """Make the object."""
        ob, scene = active_splats(context), context.scene
        frame_sync.update_meshes(scene)
        if problem := frame_sync.problem_of(ob):
            raise ValueError(problem)
        moment = moment_of(ob, scene.frame_current_final, wait=True)
        if moment is not None and moment.hidden:
            raise ValueError(f"{ob.name} shows nothing at this frame of the timeline.")
        number = moment.files[0].number if moment is not None else scene.frame_current
        kept = keep_frame(ob, number)
        make_active(context, kept)
        return f"{kept.name} has {len(kept.data.vertices):,} splats."


class RescanFrames(OnSequence, bpy.types.Operator):
    """Scan the folder of the frames again, and retry files that could not be read"""

    bl_idname = "gscore.look_at_frames_again"
    bl_label = "Rescan Frames"
    bl_options: ClassVar = {"REGISTER"}

    def run(self, context: bpy.types.Context) -> None:
        """Scan."""
        LIBRARY.forget(folder_of(active_splats(context)))
        frame_sync.settings_changed(active_splats(context))


def _draw_import(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    self.layout.operator(ImportSequence.bl_idname, text="Gaussian Splat Sequence (folder)")


APPENDED = ((bpy.types.TOPBAR_MT_file_import, _draw_import),)


def importing_sequence(
    context: bpy.types.Context,
    folder: Path,
    *,
    called: str = "",
    start: int = 1,
    parent: bpy.types.Object | None = None,
    up: str = "-Y",
) -> Steps[tuple[bpy.types.Object, Series, list[str]]]:
    """Make a splat object that plays the frames in a folder. A thread finds the frames and reads
    the first, which is then written to Blender.

    Args:
        context: The object is linked to its collection.
        folder: Absolute; as for `find_series`.
        called: Name pattern of the frames, if the folder has several.
        start: Frame of the timeline that shows the first one.
        parent: The empty of the capture that the splats were trained from.
        up: Without `parent`, the axis of the files that points up, a key of
            `splat_files.UP_AXES`.

    Returns:
        The object, its frames, and warnings.

    Raises:
        GsError: the first frame cannot be read; the scene is untouched.
        ValueError: there are no frames.
    """
    found: list[Series] = []

    def first(request: ImportRequest) -> ImportRequest:
        found.append(find_series(folder, called))
        return replace(request, path=found[0].files[0].path)

    request = splat_files.import_request(folder, parent=parent, up=up)
    made = yield from importing_splats(context, [request], find=first, note=mesh.mark_of)
    (ob,), (mark,), series = made.objects, made.notes, found[0]
    ob.name = ob.data.name = folder.name
    mesh.note(ob.data, series.files[0], mark)
    LIBRARY.forget((folder, called))
    own = ob.gscore_sequence
    own.start, own.files = start, called
    own.folder = relative(folder)  # last, because setting it starts playback
    return ob, series, made.warnings


def keep_frame(ob: bpy.types.Object, number: int) -> bpy.types.Object:
    """A separate object with the current splats of a sequence object, without a sequence.

    Args:
        ob: Plays a sequence.
        number: Of the frame, for the name.
    """
    kept = ob.copy()
    kept.data = ob.data.copy()
    mesh.forget(kept.data)
    kept.gscore_sequence.folder = ""
    kept.gscore_sequence.edited = False
    kept.name = kept.data.name = f"{ob.name} {number}"
    editable_check.link_like(kept, ob)
    return kept
