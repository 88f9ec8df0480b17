"""Sequence import: a folder of frames as one splat object that plays them."""

from pathlib import Path

import bpy

from ..cameras.capture_transform import origin_of
from ..core import read_splat_file
from ..interface import editable_check
from ..paths import relative
from ..splats import objects, splat_files
from ..splats.objects import ANTIALIAS
from . import mesh
from .frames import Series, find_series
from .library import LIBRARY


def import_sequence(
    context: bpy.types.Context,
    folder: Path,
    *,
    called: str = "",
    start: int = 1,
    parent: bpy.types.Object | None = None,
    up: str = "-Y",
) -> tuple[bpy.types.Object, Series]:
    """Make a splat object that plays the frames in a folder.

    Args:
        context: The object is linked to its collection.
        folder: Absolute; as for `find_series`.
        called: Name pattern of the frames, if the folder has several.
        start: Frame of the timeline that shows the first one.
        parent: The empty of the capture that the splats were trained from.
        up: Without `parent`, the axis of the files that points up, a key of `files.UP_AXES`.

    Returns:
        The object, and its frames.

    Raises:
        GsError: the first frame cannot be read; the scene is untouched.
        ValueError: there are no frames.
    """
    series = find_series(folder, called)
    first = series.files[0]
    read = read_splat_file(first.path).of_capture(origin_of(parent))
    ob = objects.create(read.splats, folder.name, collection=context.collection, parent=parent)
    if read.antialiased:
        ob[ANTIALIAS] = True
    splat_files.match_capture_origin(ob, read.origin)
    if parent is None:
        splat_files.turn_up(ob, up)
    mesh.note(ob.data, first)
    set_up_playback(ob, folder, called=called, start=start)
    return ob, series


def set_up_playback(ob: bpy.types.Object, folder: Path, *, called: str, start: int) -> None:
    """Set up playback of a folder on an object whose mesh has its first frame.

    Args:
        As `import_sequence`.
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
