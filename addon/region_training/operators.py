"""Region training operators."""

from typing import ClassVar

import bpy
from bpy.props import BoolProperty

from ..interface.base_operator import BaseOperator
from ..splats.objects import is_splats, meant
from ..training import start_training
from ..training.verb_job import FAILED
from ..training.verb_operators import Cancelling
from . import train_region
from .job import RegionJob


class TrainRegion(BaseOperator, bpy.types.Operator):
    """Train the splats in the crop box again, in the background; all others are frozen.
    The result replaces them when it is complete; undo restores the earlier splats"""

    bl_idname = "gscore.train_region"
    bl_label = "Train Region"
    bl_options: ClassVar = {"REGISTER"}

    wait: BoolProperty(
        name="Wait",
        description="Return when the training has ended; for scripts",
        options={"HIDDEN", "SKIP_SAVE"},
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether a splat object or its crop object is active."""
        if is_splats(meant(context)):
            return True
        cls.poll_message_set("Select splats, or their crop box")
        return False

    def act(self, context: bpy.types.Context) -> str:
        """Start."""
        self.warn(start_training.unsaved(context.scene))
        job = train_region.train_region(context.scene, meant(context), wait=self.wait)
        if job.status == FAILED:
            raise ValueError(job.sentence)
        return job.sentence


class StopRegion(Cancelling, bpy.types.Operator):
    """Cancel the region training; the splats are not changed"""

    bl_idname = "gscore.stop_region"
    bl_label = "Stop"
    none = "No region is being trained."

    def job_of(self, scene: bpy.types.Scene) -> RegionJob | None:
        """The region training of the scene's capture."""
        return train_region.job_of(scene)


CLASSES = (TrainRegion, StopRegion)
