"""Undistortion operators, and the cache size in the preferences."""

from collections.abc import Iterable
from pathlib import Path
from typing import ClassVar

import bpy
from bpy.props import StringProperty

from ..interface.base_operator import BaseOperator, Condition, ConfirmMixin, Undoable, wrapped
from ..interface.lookup import Lookup
from ..preferences import SECTIONS, Preferences
from ..process import poll_timer
from . import undistort_jobs, undistorted_photos
from .lookup import find_root
from .objects import cameras_of
from .undistort_jobs import missing_copies

_SIZES: Lookup[Path, tuple[int, int]] = Lookup(undistorted_photos.size_of, max_age=5.0)
"""Number of copies by folder, and their bytes."""


class UndistortPhotos(Undoable, bpy.types.Operator):
    """Make the missing undistorted copies of photos for the cameras' backgrounds"""

    bl_idname = "gscore.straighten_photos"
    bl_label = "Undistort Photos"

    capture: StringProperty(
        name="Capture",
        description="Name of the capture's empty; empty: the capture of the active object, of the "
        "scene camera, or the only one",
        options={"SKIP_SAVE"},
    )

    def run(self, context: bpy.types.Context) -> str:
        """Queue the copies; without a window, wait for them."""
        cameras = cameras_of(find_root(context, self.capture))
        count = undistort_jobs.queue_copies(cameras)
        if bpy.app.background:
            undistort_jobs.wait()
        elif count:
            return f"Undistorting {count} photos in the background."
        problems = undistort_jobs.problems_of(missing_copies(cameras))
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
    needs = Condition(lambda context: undistort_jobs.QUEUE.busy, "No photos are being undistorted")

    def run(self, context: bpy.types.Context) -> None:
        """Clear the queue."""
        undistort_jobs.QUEUE.stop()


class RemoveUndistortedPhotos(ConfirmMixin, BaseOperator, bpy.types.Operator):
    """Remove all undistorted copies of photos; they are made again when needed"""

    bl_idname = "gscore.remove_straight_photos"
    bl_label = "Remove Undistorted Photos"
    bl_options: ClassVar = {"REGISTER"}
    confirm = "Remove"
    needs = Condition(
        lambda context: not undistort_jobs.QUEUE.busy,
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


_POLLER = poll_timer.Poller(_SIZES.collect, lambda: _SIZES.busy)


APPENDED = ((SECTIONS, draw_copies), (poll_timer.POLLERS, _POLLER))
