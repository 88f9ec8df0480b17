"""Region training operators."""

import bpy

from ..splats.objects import active_splats, is_splats
from ..training import start_training
from ..training.verb_job import VerbJob
from ..training.verb_operators import Cancelling, Starting
from . import train_region


class TrainRegion(Starting, bpy.types.Operator):
    """Train the splats in the crop box again, in the background; all others are frozen.
    The result replaces them when it is complete; undo restores the earlier splats"""

    bl_idname = "gscore.train_region"
    bl_label = "Train Region"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Whether a splat object or its crop object is active."""
        if is_splats(active_splats(context)):
            return True
        cls.poll_message_set("Select splats, or their crop box")
        return False

    def start(self, context: bpy.types.Context) -> VerbJob:
        """Start."""
        self.warn(start_training.unsaved(context.scene))
        return train_region.train_region(context.scene, active_splats(context), wait=self.wait)


class StopRegion(Cancelling, bpy.types.Operator):
    """Cancel the region training; the splats are not changed"""

    bl_idname = "gscore.stop_region"
    bl_label = "Stop"
    none = "No region is being trained."
    job_of = staticmethod(train_region.job_of)


CLASSES = (TrainRegion, StopRegion)
