"""Operators of straightened copies, and the part of the preferences that tells their size."""

from collections.abc import Iterable
from pathlib import Path
from typing import ClassVar

import bpy
from bpy.props import StringProperty

from ..interface.lookup import Lookup
from ..interface.operators import Acting
from ..interface.questions import Asking, wrapped
from ..preferences import SECTIONS, Preferences
from ..process import beat
from . import straight, straightening
from .lacking import lack_of
from .lookup import find_root
from .objects import cameras_of

_SIZES: Lookup[Path, tuple[int, int]] = Lookup(straight.size_of, max_age=5.0)
"""Copies in the folder, and their bytes."""


class StraightenPhotos(Acting, bpy.types.Operator):
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
        count = straightening.ask(cameras)
        if bpy.app.background:
            straightening.wait()
        elif count:
            return f"{count} photos are being straightened."
        problems = straightening.problems_of(lack_of(cameras))
        if problems:
            raise ValueError(problems[0])
        if not count:
            return "No photo lacks a straightened copy."
        return f"{count} photos are straightened, in {straight.copies_folder()}."


class StopStraightening(Acting, bpy.types.Operator):
    """Straighten no more photos; Straighten Photos, or looking through a camera, goes on"""

    bl_idname = "gscore.stop_straightening"
    bl_label = "Stop Straightening"
    bl_options: ClassVar = {"REGISTER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Some are being straightened."""
        if straightening.QUEUE.busy:
            return True
        cls.poll_message_set("No photos are being straightened")
        return False

    def act(self, context: bpy.types.Context) -> str:
        """Stop."""
        straightening.QUEUE.stop()
        return ""


class RemoveStraightPhotos(Asking, Acting, bpy.types.Operator):
    """Remove all straightened copies of photos; they are made again when they are looked at"""

    bl_idname = "gscore.remove_straight_photos"
    bl_label = "Remove Straightened Photos"
    bl_options: ClassVar = {"REGISTER"}
    confirm = "Remove"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """None are being made."""
        if not straightening.QUEUE.busy:
            return True
        cls.poll_message_set("Photos are being straightened; stop that first")
        return False

    def question(self, context: bpy.types.Context) -> Iterable[str]:
        """How many, and where."""
        folder = straight.copies_folder()
        count, size = straight.size_of(folder)
        if not count and not straight.left_over(folder):
            raise ValueError(f"There are no straightened photos in {folder}.")
        return [f"{count} copies of photos, {size / 1e6:.0f} MB, in {folder}. Photos stay."]

    def act(self, context: bpy.types.Context) -> str:
        """Remove them."""
        folder = straight.copies_folder()
        files = straight.copies(folder)
        straight.remove(files + straight.left_over(folder))
        _SIZES.expire()
        return f"{len(files)} straightened copies are removed from {folder}."


def draw_copies(layout: bpy.types.UILayout, prefs: Preferences) -> None:
    """How large the folder of copies is, and the button that empties it."""
    folder = straight.copies_folder()
    count, size = _SIZES.get(folder)[0] or (0, 0)
    beat.ensure()  # which has this drawn again when more is known
    if not count:
        return
    box = layout.box()
    wrapped(box, f"Straightened photos: {count} files, {size / 1e6:.0f} MB, in {folder}")
    box.operator(RemoveStraightPhotos.bl_idname, icon="TRASH")


CLASSES = (StraightenPhotos, StopStraightening, RemoveStraightPhotos)


_FOLLOWER = beat.Follower(_SIZES.collect, lambda: _SIZES.busy)


def on_register() -> None:
    """Draw in the preferences."""
    SECTIONS.append(draw_copies)
    beat.FOLLOWERS.append(_FOLLOWER)


def on_unregister() -> None:
    """Draw there no more."""
    beat.FOLLOWERS.remove(_FOLLOWER)
    SECTIONS.remove(draw_copies)
