"""Sequence training settings of a scene."""

import bpy

from ..core import SequenceOptions
from ..training.properties import declared


class TrainSequenceSettings(bpy.types.PropertyGroup):
    """Options of a sequence in addition to those of its frames."""

    frames: declared(
        SequenceOptions(),
        "frames",
        "Frames",
        default="",
        description="Frames to train: 0,5,12 or 0:30 or 0:30:5 (first, last, step); empty: all",
    )
    next_iterations: declared(SequenceOptions(), "next_iterations", "Steps of Later Frames")
    warm_start: declared(SequenceOptions(), "warm_start", "Start from the Frame Before")
    guide_start: bpy.props.IntProperty(
        name="First Guide Frame",
        description="Frame of the timeline at which the guide meshes match the first trained "
        "frame. Later frames of the sequence use later ones",
        default=1,
    )


PROPERTIES = (
    (
        bpy.types.Scene,
        "gscore_train_sequence",
        bpy.props.PointerProperty(type=TrainSequenceSettings),
    ),
)
