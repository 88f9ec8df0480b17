"""Region training panel: train a region of the splats again."""

import bpy

from ..core import Started
from ..region_training import train_region
from ..splats.objects import active_splats
from ..training.verb_job import VerbJob
from .widgets import SplatsPanel, draw_verb, has_python, sentence


class RegionPanel(SplatsPanel, bpy.types.Panel):
    """Train the splats in the crop box again; all others are frozen"""

    bl_idname = "GSCORE_PT_region"
    bl_label = "Train a Region"
    bl_parent_id = "GSCORE_PT_result"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, ob = self.layout, active_splats(context)
        job = train_region.job_of(context.scene)
        if job is not None:
            draw_verb(layout, job, bar_text(job), "gscore.stop_region")
            started = job.last(Started)
            if not job.ended and started is not None and (region := started.decision("region")):
                sentence(layout, region)
            if not job.ended:
                return
        if not context.scene.gscore.capture_path.strip():
            sentence(layout, "Choose the capture of these splats under Capture.", icon="INFO")
            return
        if ob.gscore.crop_object is None:
            sentence(layout, "Put a crop box around the region to train.", icon="INFO")
            layout.operator("gscore.add_crop_box", icon="CUBE")
            return
        if not has_python(layout):
            return
        layout.prop(context.scene.gscore_steer, "region_steps")
        layout.operator("gscore.train_region", icon="PLAY")


def bar_text(job: VerbJob) -> str:
    """Text of the progress bar."""
    if job.preparing is not None:
        return "Writing the splats"
    last = job.progress
    return "Starting" if last is None or not last.splats else f"Step {last.step:,}"
