"""Frame lookup: the frame of a splat object at a time, and its splats."""

import os
from collections.abc import Hashable
from dataclasses import dataclass
from pathlib import Path

import bpy

from .. import preferences
from ..interface.option_labels import error_text
from ..process import poll_timer
from .frames import FrameFile, Series
from .library import LIBRARY, NOTHING, Folder, Frame
from .settings import is_sequence, plays, timing_of

AHEAD = 48
"""Number of timeline frames to read ahead, memory permitting."""
_MB = 1_000_000


@dataclass(frozen=True, kw_only=True)
class Moment:
    """State of a sequence object at one frame of the timeline."""

    name: str
    """Name of the object."""
    owner: Hashable
    """Identity of the object in this Blender session."""
    files: tuple[FrameFile, ...]
    """The current frame, then the next ones; empty if none is shown or known."""
    hidden: bool
    """True before the start and after the end of a sequence that hides there."""
    problem: str
    """Error message if no frame is known."""

    def ready(self) -> Frame | None:
        """The frame if it is in memory; else None, and it is queued like the next ones."""
        if self.hidden:
            return NOTHING
        LIBRARY.most = preferences.get().sequence_memory * _MB
        LIBRARY.request(self.owner, self.files)
        found = LIBRARY.frame(self.files[0])[0] if self.files else None
        if found is None:
            poll_timer.ensure()  # redraws views when the frame is loaded
        return found

    @property
    def file_label(self) -> str:
        """`FrameFile.label` of the current frame; empty if unknown."""
        if self.hidden:
            return NOTHING.file.label
        return self.files[0].label if self.files else ""

    def failed(self) -> bool:
        """True if the frame cannot be read."""
        return bool(self.problem) or bool(self.files and LIBRARY.frame(self.files[0])[1])

    def waits(self) -> bool:
        """True while the frame is being read or searched."""
        if self.hidden or self.failed():
            return False
        return not self.files or LIBRARY.frame(self.files[0])[0] is None

    def frame(self) -> Frame:
        """The frame, read synchronously if it is not in memory.

        Raises:
            ValueError: it cannot be read; the message names the object.
        """
        if self.hidden:
            return NOTHING
        found, problem = None, self.problem
        if self.files:
            found, problem = LIBRARY.frame(self.files[0], wait=True)
            LIBRARY.request(self.owner, self.files)  # read the next ones while this one is drawn
        if found is None:
            raise ValueError(f"{self.name}: {problem}")
        return found


def moment_of(ob: bpy.types.Object, frame: float, *, wait: bool = False) -> Moment | None:
    """State of an object at a frame; None if it shows its own mesh.

    Args:
        ob: Evaluated or original.
        frame: Timeline frame, with subframe.
        wait: List the files synchronously.
    """
    ob = ob.original  # evaluated copies do not have changes by handlers yet
    if not plays(ob):
        return None
    series, problem = series_of(ob, wait=wait)
    files: tuple[FrameFile, ...] = ()
    hidden = False
    if series is not None:
        timing = timing_of(ob)
        hidden = timing.slot(frame, series.slots) is None
        slots = timing.ahead(frame, series.slots, AHEAD)
        files = tuple(dict.fromkeys(series.at(slot) for slot in slots))
    return Moment(
        name=ob.name,
        owner=ob.session_uid,
        files=() if hidden else files,
        hidden=hidden,
        problem=problem,
    )


def series_of(ob: bpy.types.Object, *, wait: bool = False) -> tuple[Series | None, str]:
    """The files of an object's sequence as `Library.series`; (None, a sentence) without one."""
    ob = ob.original
    if not is_sequence(ob):
        return None, f"{ob.name} has no sequence."
    try:
        folder = folder_of(ob)
    except ValueError as error:
        return None, error_text(error)
    return LIBRARY.series(folder, wait=wait)


def folder_of(ob: bpy.types.Object) -> Folder:
    """Folder and name pattern of an object's frames.

    Raises:
        ValueError: the folder is relative to a file that is not saved.
    """
    text, library = ob.gscore_sequence.folder.strip(), ob.library
    if text.startswith("//") and library is None and not bpy.data.filepath:
        raise ValueError(
            f"The frame folder {text} is relative to the .blend file, which is not saved: save it, "
            "or choose a folder with its full path."
        )
    path = os.path.normpath(bpy.path.abspath(text, library=library))
    return Path(path), ob.gscore_sequence.files.strip()


def gap_sentence(ob: bpy.types.Object) -> str:
    """Sentence about missing frames of an object's sequence; empty if none or unknown."""
    series, _ = series_of(ob)
    return "" if series is None or not series.gaps else f"{ob.name}: {series.gap_text()}"
