"""Undistortion operators, and the cache size in the preferences."""

from collections.abc import Iterable
from pathlib import Path
from typing import ClassVar

import bpy
from bpy.props import StringProperty

from ..interface.base_operator import BaseOperator
from ..interface.confirm_operator import ConfirmMixin, wrapped
from ..interface.lookup import Lookup
from ..preferences import SECTIONS, Preferences
from ..process import poll_timer
from . import undistort_jobs, undistorted_photos
from .lookup import find_root
from .missing_undistorted import lack_of
from .objects import cameras_of

_SIZES: Lookup[Path, tuple[int, int]] = Lookup(undistorted_photos.size_of, max_age=5.0)
"""Copies in the folder, and their bytes."""


class StraightenPhotos(BaseOperator, bpy.types.Operator):
    """Make the straightened copies of photos that the cameras' backgrounds lack"""

    bl_idname = "gscore.straighten_photos"
    bl_label = "Straighten Photos"
    bl_options: ClassVar = {"REGISTER", "UNDO"}

    capture: StringProperty(
        name="Capture",
        description="Name of the capture's empty; without one, that of the active object, of the "
        "scene camera, or the only one there is",
        options={"SKIP_SAVE"},
    )

    def act(self, context: bpy.types.Context) -> str:
        """Ask for them; without a window, wait until they are there."""
        cameras = cameras_of(find_root(context, self.capture))
        count = undistort_jobs.ask(cameras)
        if bpy.app.background:
            undistort_jobs.wait()
        elif count:
            return f"{count} photos are being straightened."
        problems = undistort_jobs.problems_of(lack_of(cameras))
        if problems:
            raise ValueError(problems[0])
        if not count:
            return "No photo lacks a straightened copy."
        return f"{count} photos are straightened, in {undistorted_photos.copies_folder()}."


class StopStraightening(BaseOperator, bpy.types.Operator):
    """Straighten no more photos; Straighten Photos, or looking through a camera, goes on"""

    bl_idname = "gscore.stop_straightening"
    bl_label = "Stop Straightening"
    bl_options: ClassVar = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Some are being straightened."""
        if undistort_jobs.QUEUE.busy:
            return True
        cls.poll_message_set("No photos are being straightened")
        return False

    def act(self, context: bpy.types.Context) -> str:
        """Stop."""
        undistort_jobs.QUEUE.stop()
        return ""


class RemoveStraightPhotos(ConfirmMixin, BaseOperator, bpy.types.Operator):
    """Remove all straightened copies of photos; they are made again when they are looked at"""

    bl_idname = "gscore.remove_straight_photos"
    bl_label = "Remove Straightened Photos"
    bl_options: ClassVar = {"REGISTER"}
    confirm = "Remove"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """None are being made."""
        if not undistort_jobs.QUEUE.busy:
            return True
        cls.poll_message_set("Photos are being straightened; stop that first")
        return False

    def question(self, context: bpy.types.Context) -> Iterable[str]:
        """How many, and where."""
        folder = undistorted_photos.copies_folder()
        count, size = undistorted_photos.size_of(folder)
        if not count and not undistorted_photos.left_over(folder):
            raise ValueError(f"There are no straightened photos in {folder}.")
        return [f"{count} copies of photos, {size / 1e6:.0f} MB, in {folder}. Photos stay."]

    def act(self, context: bpy.types.Context) -> str:
        """Remove them."""
        folder = undistorted_photos.copies_folder()
        files = undistorted_photos.copies(folder)
        undistorted_photos.remove(files + undistorted_photos.left_over(folder))
        _SIZES.expire()
        return f"{len(files)} straightened copies are removed from {folder}."


def draw_copies(layout: bpy.types.UILayout, prefs: Preferences) -> None:
    """How large the folder of copies is, and the button that empties it."""
    folder = undistorted_photos.copies_folder()
    count, size = _SIZES.get(folder)[0] or (0, 0)
    poll_timer.ensure()  # which has this drawn again when more is known
    if not count:
        return
    box = layout.box()
    wrapped(box, f"Straightened photos: {count} files, {size / 1e6:.0f} MB, in {folder}")
    box.operator(RemoveStraightPhotos.bl_idname, icon="TRASH")


CLASSES = (StraightenPhotos, StopStraightening, RemoveStraightPhotos)


_FOLLOWER = poll_timer.Poller(_SIZES.collect, lambda: _SIZES.busy)


def on_register() -> None:
    """Draw in the preferences."""
    SECTIONS.append(draw_copies)
    poll_timer.POLLERS.append(_FOLLOWER)


def on_unregister() -> None:
    """Draw there no more."""
    poll_timer.POLLERS.remove(_FOLLOWER)
    SECTIONS.remove(draw_copies)
