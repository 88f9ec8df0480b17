"""Undistortion jobs in the background: the photos to undistort, the update of their cameras, and
the missing copies for panels, checked in threads because each photo needs a disk access;
operators, and the size of the copies in the preferences.
"""

import os
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar

import bpy
from bpy.app.handlers import persistent

from ..interface.base_operator import BaseOperator, Condition, ConfirmMixin, wrapped
from ..interface.lookup import Lookup
from ..interface.option_labels import error_text
from ..interface.windows import redraw_views
from ..preferences import SECTIONS, Preferences
from ..process import poll_timer
from . import undistorted_photos
from .backgrounds import (
    KnownImages,
    UndistortedBackground,
    file_of,
    show_copy,
    undistorted_background,
)
from .lookup import OnCapture, find_root
from .objects import cameras_of, is_camera
from .undistort_program import task_of
from .undistort_queue import UndistortQueue

_AGE = 3.0
"""Lifetime of a cached result, seconds."""
_NEVER = 1e9
"""Maximum age for `Lookup`, seconds: results expire only here."""


@dataclass(frozen=True)
class MissingCopies:
    """Missing copies of some cameras."""

    copies: tuple[Path, ...] = ()
    """Files of the missing copies."""
    problems: tuple[str, ...] = ()
    """Errors of unreadable cameras, sentences."""


class MissingCopiesCache:
    """Missing copies of captures by session uid of their empty; main thread only."""

    def __init__(self) -> None:
        self._inputs: dict[int, tuple[list[UndistortedBackground], list[str]]] = {}
        self._times: dict[int, float] = {}
        self._lookup: Lookup[int, MissingCopies] = Lookup(
            lambda uid: _check(*self._inputs.get(uid, ((), ()))), max_age=_NEVER
        )

    def of(self, root: bpy.types.Object, cameras: Iterable[bpy.types.Object]) -> MissingCopies:
        """Cached result for the cameras of a capture."""
        uid, now = root.session_uid, time.monotonic()
        if not self.busy and now - self._times.get(uid, float("-inf")) > _AGE:
            self._inputs[uid], self._times[uid] = _backgrounds(cameras), now
            self._lookup.expire()
        lack = self._lookup.get(uid)[0] or MissingCopies()
        poll_timer.ensure()
        return lack

    def expire(self) -> None:
        """Check all captures again at their next request."""
        self._times.clear()

    def clear(self) -> None:
        """Drop all results after a file load."""
        self._times.clear()
        self._inputs.clear()

    def collect(self) -> bool:
        """Collect results of threads; True if any is new."""
        return self._lookup.collect()

    @property
    def busy(self) -> bool:
        """True while a thread runs."""
        return self._lookup.busy


def _backgrounds(
    cameras: Iterable[bpy.types.Object],
) -> tuple[list[UndistortedBackground], list[str]]:
    """Backgrounds of cameras as read from bpy, and errors."""
    backgrounds, problems = [], []
    for ob in cameras:
        try:
            background = undistorted_background(ob)
        except ValueError as error:
            problems.append(error_text(error))
            continue
        if background is not None:
            backgrounds.append(background)
    return backgrounds, problems


def _check(backgrounds: Iterable[UndistortedBackground], problems: Iterable[str]) -> MissingCopies:
    """Missing copies on disk; no bpy."""
    copies = (background.missing_copy() for background in backgrounds)
    return MissingCopies(tuple(copy for copy in copies if copy is not None), tuple(problems))


QUEUE = UndistortQueue()
"""Undistortion queue of this Blender session."""
MISSING_COPIES = MissingCopiesCache()
"""Cache of missing undistorted copies, for panels."""
_PAUSE = 0.05
"""Polling interval of a waiting script, seconds."""


def queue_copies(cameras: Iterable[bpy.types.Object]) -> int:
    """Queue the missing copies of the cameras' backgrounds, in this order; returns their number.

    Backgrounds are set to their copies. Without a window nothing starts until `wait` is called.
    Cameras without their custom properties are left out.
    """
    tasks, outdated = [], []
    for ob in cameras:
        with suppress(ValueError):
            background = undistorted_background(ob)
            copy = None if background is None else background.missing_copy()
            if copy is None:
                continue
            if background.file != copy:
                outdated.append((ob, copy))
            if not copy.is_file():
                tasks.append(task_of(background.own, copy))
    if outdated:
        known = KnownImages()
        for ob, copy in outdated:
            show_copy(ob, copy, known)
    begin(tasks)
    return len(tasks)


def begin(tasks: Sequence[dict[str, Any]]) -> None:
    """Queue tasks (`undistort_program.task_of`), in this order."""
    if tasks:
        QUEUE.enqueue_first(tasks)
        poll_timer.ensure()
    MISSING_COPIES.expire()


def wait() -> None:
    """Block until all queued copies are written or have failed."""
    while QUEUE.busy:
        collect()
        time.sleep(_PAUSE)


def problems_of(lack: MissingCopies) -> list[str]:
    """Errors of missing copies, as sentences."""
    problems = (QUEUE.problems.get(str(copy)) for copy in lack.copies)
    return [*lack.problems, *filter(None, problems)]


def collect() -> bool:
    """Collect written copies; True if panels need a redraw."""
    if not QUEUE.busy:
        return False
    made = {Path(copy) for copy in QUEUE.poll(_program)}
    if made:
        for image in bpy.data.images:
            if image.source == "FILE" and file_of(image) in made:
                image.reload()
        redraw_views()
    if made or not QUEUE.busy:
        MISSING_COPIES.expire()
    return bool(made) or not QUEUE.busy


def _program() -> tuple[list[str], Mapping[str, str]]:
    """Command line of a background Blender without the user's add-ons, for `undistort_program`."""
    library = find_spec("gscore")
    assert library is not None and library.origin is not None
    path = [str(Path(__file__).parents[2]), str(Path(library.origin).parents[1])]
    code = (
        f"import sys; sys.path[:0] = {path!r}; "
        "from addon.cameras.undistort_program import main; main()"
    )
    if bpy.app.binary_path:
        options = ["--background", "--factory-startup", "--python-exit-code", "1"]
        return [bpy.app.binary_path, *options, "--python-expr", code], {}
    return [sys.executable, "-c", code], {"PYTHONPATH": os.pathsep.join(path)}


@persistent
def _file_loaded(*_: object) -> None:
    """Queue copies that are missing on this computer or outdated."""
    MISSING_COPIES.clear()
    if not bpy.app.background:
        queue_copies(ob for ob in bpy.data.objects if is_camera(ob) and ob.library is None)


def on_unregister() -> None:
    """Kill the program; a partly written copy is discarded."""
    QUEUE.kill()


_SIZES: Lookup[Path, tuple[int, int]] = Lookup(undistorted_photos.size_of, max_age=5.0)
"""Number of copies by folder, and their bytes."""


class UndistortPhotos(OnCapture, bpy.types.Operator):
    """Make the missing undistorted copies of photos for the cameras' backgrounds"""

    bl_idname = "gscore.straighten_photos"
    bl_label = "Undistort Photos"

    def run(self, context: bpy.types.Context) -> str:
        """Queue the copies; without a window, wait for them."""
        cameras = cameras_of(find_root(context, self.capture))
        count = queue_copies(cameras)
        if bpy.app.background:
            wait()
        elif count:
            return f"Undistorting {count} photos in the background."
        problems = problems_of(_check(*_backgrounds(cameras)))
        if problems:
            raise ValueError(problems[0])
        if not count:
            return "No undistorted photo is missing."
        return f"Undistorted {count} photos, in {undistorted_photos.copies_folder()}."


class StopUndistorting(BaseOperator, bpy.types.Operator):
    """Stop undistorting photos; Undistort Photos, or looking through a camera, continues"""

    bl_idname = "gscore.stop_straightening"
    bl_label = "Stop Undistorting"
    bl_options: ClassVar = {"REGISTER"}
    needs = Condition(lambda context: QUEUE.busy, "No photos are being undistorted")

    def run(self, context: bpy.types.Context) -> None:
        """Clear the queue."""
        QUEUE.stop()


class RemoveUndistortedPhotos(ConfirmMixin, BaseOperator, bpy.types.Operator):
    """Remove all undistorted copies of photos; they are made again when needed"""

    bl_idname = "gscore.remove_straight_photos"
    bl_label = "Remove Undistorted Photos"
    bl_options: ClassVar = {"REGISTER"}
    confirm = "Remove"
    needs = Condition(
        lambda context: not QUEUE.busy,
        "Photos are being undistorted; stop that first",
    )

    def confirm_lines(self, context: bpy.types.Context) -> Iterable[str]:
        """Number, size and folder of the copies."""
        folder = undistorted_photos.copies_folder()
        count, size = undistorted_photos.size_of(folder)
        if not count and not undistorted_photos.partial_files(folder):
            raise ValueError(f"There are no undistorted photos in {folder}.")
        return [f"{count} undistorted copies, {size / 1e6:.0f} MB, in {folder}. The photos stay."]

    def run(self, context: bpy.types.Context) -> str:
        """Remove the copies."""
        folder = undistorted_photos.copies_folder()
        files = undistorted_photos.copies(folder)
        undistorted_photos.remove(files + undistorted_photos.partial_files(folder))
        _SIZES.expire()
        return f"Removed {len(files)} undistorted copies from {folder}."


def draw_copies(layout: bpy.types.UILayout, prefs: Preferences) -> None:
    """Draw the size of the folder of copies, and the button that empties it."""
    folder = undistorted_photos.copies_folder()
    count, size = _SIZES.get(folder)[0] or (0, 0)
    poll_timer.ensure()  # draws this again when the size is known
    if not count:
        return
    box = layout.box()
    wrapped(box, f"Undistorted photos: {count} files, {size / 1e6:.0f} MB, in {folder}")
    box.operator(RemoveUndistortedPhotos.bl_idname, icon="TRASH")


_POLLERS = (
    poll_timer.Poller(collect, lambda: QUEUE.busy),
    poll_timer.Poller(MISSING_COPIES.collect, lambda: MISSING_COPIES.busy),
    poll_timer.Poller(_SIZES.collect, lambda: _SIZES.busy),
)
HANDLERS = {"load_post": _file_loaded}
APPENDED = ((SECTIONS, draw_copies), *((poll_timer.POLLERS, poller) for poller in _POLLERS))
