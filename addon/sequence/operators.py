"""Sequence training operators, train, resume and stop, and their settings."""

import bpy
from bpy.props import BoolProperty

from ..core import SequenceOptions
from ..interface.base_operator import ConfirmMixin
from ..training.properties import declared
from ..training.verb_job import VerbJob
from ..training.verb_jobs import Cancelling, Starting
from . import train_sequence


class TrainSequence(ConfirmMixin, Starting, bpy.types.Operator):
    """Train the frames of a multi-view video, or of a folder of captures, in the background. Each
    frame starts from the splats of the previous one"""

    bl_idname = "gscore.train_sequence"
    bl_label = "Train Sequence"

    resume: BoolProperty(
        name="Resume",
        description="Continue the sequence in the output folder",
        options={"SKIP_SAVE"},
    )
    overwrite: BoolProperty(
        name="Start Over",
        description="Replace the sequence in the output folder",
        options={"SKIP_SAVE"},
    )
    confirm = "Start Over"

    def confirm_lines(self, context: bpy.types.Context) -> list[str]:
        """List overwritten frames, and parts of the scene that the training would not use."""
        output = train_sequence.output_of(context.scene)
        lines = []
        if self.overwrite and train_sequence.is_started(output):
            lines = [f"The frames in {output} are replaced. This cannot be undone."]
        self.confirm = "Start Over" if lines else "Train Without"
        return lines if self.resume else lines + train_sequence.unsupported_parts(context.scene)

    def start(self, context: bpy.types.Context) -> VerbJob:
        """Start."""
        if not self.resume:
            self.warn(train_sequence.unsupported_parts(context.scene))
        return train_sequence.train_sequence(
            context.scene, resume=self.resume, overwrite=self.overwrite, wait=self.wait
        )


class StopSequence(Cancelling, bpy.types.Operator):
    """Stop after a checkpoint; complete frames are kept, and Resume continues from there"""

    bl_idname = "gscore.stop_sequence"
    bl_label = "Stop"
    none = "No sequence is being trained."
    job_of = staticmethod(train_sequence.job_of)


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
