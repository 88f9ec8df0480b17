"""Sequence training operators: train, resume, stop."""

from typing import ClassVar

import bpy
from bpy.props import BoolProperty

from ..interface.base_operator import BaseOperator
from ..interface.confirm_operator import ConfirmMixin
from ..training.verb_job import FAILED
from ..training.verb_operators import Cancelling
from . import train_sequence
from .job import SequenceJob


class TrainSequence(ConfirmMixin, BaseOperator, bpy.types.Operator):
    """Train the frames of a multi-view video, or of a folder of captures, in the background. Each
    frame starts from the splats of the previous one"""

    bl_idname = "gscore.train_sequence"
    bl_label = "Train Sequence"
    bl_options: ClassVar = {"REGISTER"}

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
    wait: BoolProperty(
        name="Wait",
        description="Return when the training has ended; for scripts",
        options={"HIDDEN", "SKIP_SAVE"},
    )
    confirm = "Start Over"

    def question(self, context: bpy.types.Context) -> list[str]:
        """List overwritten frames, and parts of the scene that the training would not use."""
        output = train_sequence.output_of(context.scene)
        lines = []
        if self.overwrite and train_sequence.is_started(output):
            lines = [f"The frames in {output} are replaced. This cannot be undone."]
        self.confirm = "Start Over" if lines else "Train Without"
        return lines if self.resume else lines + train_sequence.not_seen(context.scene)

    def act(self, context: bpy.types.Context) -> str:
        """Start."""
        if not self.resume:
            self.warn(train_sequence.not_seen(context.scene))
        job = train_sequence.train_sequence(
            context.scene, resume=self.resume, overwrite=self.overwrite, wait=self.wait
        )
        if job.status == FAILED:
            raise ValueError(job.sentence)
        return job.sentence


class StopSequence(Cancelling, bpy.types.Operator):
    """Stop after a checkpoint; complete frames are kept, and Resume continues from there"""

    bl_idname = "gscore.stop_sequence"
    bl_label = "Stop"
    none = "No sequence is being trained."

    def job_of(self, scene: bpy.types.Scene) -> SequenceJob | None:
        """The training of the scene's sequence."""
        return train_sequence.job_of(scene)


CLASSES = (TrainSequence, StopSequence)
