"""Sequence training operators: train, resume, stop."""

import bpy
from bpy.props import BoolProperty

from ..interface.base_operator import ConfirmMixin
from ..training.verb_job import VerbJob
from ..training.verb_operators import Cancelling, Starting
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
