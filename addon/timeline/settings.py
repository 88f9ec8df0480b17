"""Sequence settings of a splat object, stored in the .blend file."""

from collections.abc import Callable

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty

from .. import compat
from .frames import HIDE, HOLD, LOOP, Timing

_BEYOND = [
    (HOLD, "Hold", "Show the first frame before the sequence, and the last one after it"),
    (LOOP, "Loop", "Repeat the sequence, also before its start"),
    (HIDE, "Hide", "Show nothing before the first frame and after the last one"),
]
CHANGED: list[Callable[[bpy.types.Object], None]] = []
"""Callbacks for an object whose settings a user has changed."""


def _update(self: "SequenceSettings", context: bpy.types.Context) -> None:
    for callback in CHANGED:
        callback(self.id_data)


class SequenceSettings(bpy.types.PropertyGroup):
    """The sequence of one splat object."""

    folder: StringProperty(
        name="Folder",
        description="Folder of the frames; empty: no sequence",
        subtype="DIR_PATH",
        options=compat.BLEND_RELATIVE,
        update=_update,
    )
    files: StringProperty(
        name="Files",
        description="File name pattern of the frames with # for the number; empty: the most "
        "frequent pattern in the folder",
        update=_update,
    )
    start: IntProperty(
        name="Start",
        description="Frame of the timeline that shows the first frame of the sequence",
        default=1,
        update=_update,
    )
    offset: IntProperty(
        name="Offset",
        description="Number of frames to skip at the beginning of the sequence",
        default=0,
        min=0,
        update=_update,
    )
    speed: FloatProperty(
        name="Speed",
        description="Frames of the sequence per frame of the timeline: 0.5 shows each twice, -1 "
        "plays backwards",
        default=1.0,
        soft_min=-4.0,
        soft_max=4.0,
        update=_update,
    )
    step: IntProperty(
        name="Step",
        description="Show every n-th frame only, also for the duration of the skipped ones",
        default=1,
        min=1,
        soft_max=10,
        update=_update,
    )
    beyond: EnumProperty(
        name="Before and After",
        description="Frames to show before the first frame and after the last one",
        items=_BEYOND,
        update=_update,
    )
    edited: BoolProperty(
        name="Edited",
        description="The splats were edited: playback is paused to show them",
        options={"HIDDEN"},
    )


def is_sequence(ob: bpy.types.Object | None) -> bool:
    """True if an object has a sequence, playing or not."""
    settings = getattr(ob, "gscore_sequence", None)
    return settings is not None and bool(settings.folder.strip())


def plays(ob: bpy.types.Object | None) -> bool:
    """True if an object shows its sequence instead of its own mesh."""
    return is_sequence(ob) and not ob.gscore_sequence.edited


def timing_of(ob: bpy.types.Object) -> Timing:
    """Timing of an object's sequence."""
    own = ob.gscore_sequence
    return Timing(
        start=own.start, offset=own.offset, speed=own.speed, step=own.step, beyond=own.beyond
    )


PROPERTIES = (
    (bpy.types.Object, "gscore_sequence", bpy.props.PointerProperty(type=SequenceSettings)),
)
