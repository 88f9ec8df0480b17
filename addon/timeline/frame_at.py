"""Frame lookup: the frame of a splat object at a time, and its splats."""

import os
from collections.abc import Hashable
from dataclasses import dataclass
from pathlib import Path

import bpy

from .. import preferences
from ..interface.option_labels import error_words
from ..process import poll_timer
from .frames import FrameFile, Series
from .library import LIBRARY, NOTHING, Folder, Frame
from .settings import is_sequence, plays, timing_of

AHEAD = 48
"""Frames of the timeline that are read ahead, where there is room."""
_MB = 1_000_000


@dataclass(frozen=True, kw_only=True)
class Moment:
    """Of a sequence object at one frame of the timeline."""

    name: str
    """The object's."""
    owner: Hashable
    """The same for one object as long as Blender runs."""
    files: tuple[FrameFile, ...]
    """The one that shows, then those to come; empty where nothing shows or is known."""
    hidden: bool
    """Nothing shows, because the sequence has not begun or is over."""
    problem: str
    """Why no frame is known, a sentence."""

    def ready(self) -> Frame | None:
        """The frame if it is in memory; else it is read soon, as those to come are."""
        if self.hidden:
            return NOTHING
        LIBRARY.most = preferences.get().sequence_memory * _MB
        LIBRARY.want(self.owner, self.files)
        found = LIBRARY.frame(self.files[0])[0] if self.files else None
        if found is None:
            poll_timer.ensure()  # which has views drawn again when it has come
        return found

    @property
    def holds(self) -> str:
        """`FrameFile.label` of what shows; empty where that is not known."""
        if self.hidden:
            return NOTHING.file.label
        return self.files[0].label if self.files else ""

    def failed(self) -> bool:
        """Whether there is nothing to wait for, because the frame cannot be read."""
        return bool(self.problem) or bool(self.files and LIBRARY.frame(self.files[0])[1])

    def waits(self) -> bool:
        """Whether the frame is still to come, or to be found."""
        if self.hidden or self.failed():
            return False
        return not self.files or LIBRARY.frame(self.files[0])[0] is None

    def frame(self) -> Frame:
        """The frame, read at once where it is not in memory.

        Raises:
            ValueError: it cannot be read; the message names the object.
        """
        if self.hidden:
            return NOTHING
        found, problem = None, self.problem
        if self.files:
            found, problem = LIBRARY.frame(self.files[0], wait=True)
            LIBRARY.want(self.owner, self.files)  # those to come, while this one is drawn
        if found is None:
            raise ValueError(f"{self.name}: {problem}")
        return found


def moment_of(ob: bpy.types.Object, frame: float, *, wait: bool = False) -> Moment | None:
    """What an object shows; None where it shows its own mesh.

    Args:
        ob: Evaluated or original.
        frame: Of the timeline, with its fraction.
        wait: Look for the files at once, instead of in a while.
    """
    ob = ob.original  # a handler's changes are in no evaluated copy yet
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
        return None, error_words(error)
    return LIBRARY.series(folder, wait=wait)


def folder_of(ob: bpy.types.Object) -> Folder:
    """Where the frames of an object are, and what they are called.

    Raises:
        ValueError: the folder is relative to a file that is not saved.
    """
    text, library = ob.gscore_sequence.folder.strip(), ob.library
    if text.startswith("//") and library is None and not bpy.data.filepath:
        raise ValueError(
            f"The folder of the frames {text} lies beside the .blend file, which is not saved: "
            "save it, or choose a folder with its whole path."
        )
    path = os.path.normpath(bpy.path.abspath(text, library=library))
    return Path(path), ob.gscore_sequence.files.strip()


def gap_sentence(ob: bpy.types.Object) -> str:
    """Which frames of an object's sequence are missing; empty where none is, or none is known."""
    series, _ = series_of(ob)
    return "" if series is None or not series.gaps else f"{ob.name}: {series.gap_words()}"
