"""Sequence import: a folder of frames as one splat object that plays them."""

from dataclasses import replace
from pathlib import Path

import bpy

from ..interface import editable_check
from ..paths import relative
from ..process.incremental_tasks import Steps
from ..splats import splat_files
from ..splats.importing import importing_splats
from ..splats.splat_files import ImportRequest
from . import mesh
from .frames import Series, find_series
from .library import LIBRARY


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
    set_up_playback(ob, folder, called=called, start=start)
    return ob, series, made.warnings


def set_up_playback(ob: bpy.types.Object, folder: Path, *, called: str, start: int) -> None:
    """Set up playback of a folder on an object whose mesh has its first frame.

    Args:
        As `importing_sequence`.
    """
    LIBRARY.forget((folder, called))
    own = ob.gscore_sequence
    own.start, own.files = start, called
    own.folder = relative(folder)  # last, because setting it starts playback


def resume_playback(ob: bpy.types.Object) -> None:
    """Resume playback of an object with edited splats; the edits are dropped."""
    mesh.forget(ob.data)
    ob.gscore_sequence.edited = False


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
