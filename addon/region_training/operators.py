"""Region training operators and settings."""

import bpy

from ..core import TrainConfig
from ..interface.base_operator import Condition
from ..splats.objects import active_splats, has_splats
from ..training import start_training
from ..training.properties import declared
from ..training.verb_job import VerbJob
from ..training.verb_jobs import Cancelling, Starting
from . import train_region


class TrainRegion(Starting, bpy.types.Operator):
    """Train the splats in the crop box again, in the background; all others are frozen.
    The result replaces them when it is complete; undo restores the earlier splats"""

    bl_idname = "gscore.train_region"
    bl_label = "Train Region"
    needs = Condition(has_splats, "Select splats, or their crop box")

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


class RegionSettings(bpy.types.PropertyGroup):
    """Region training settings of a scene, `Scene.gscore_steer`."""

    region_steps: declared(
        TrainConfig(),
        "iterations",
        "Steps",
        default=2000,
        soft_min=200,
        soft_max=10_000,
        description="Training steps for a region, one photo each",
    )


PROPERTIES = ((bpy.types.Scene, "gscore_steer", bpy.props.PointerProperty(type=RegionSettings)),)
