"""Region training panel: train a region of the splats again."""

from typing import ClassVar

import bpy

from ..region_training import train_region
from ..region_training.job import RegionJob
from ..splats.objects import is_splats, meant
from ..training import verb_job
from .widgets import TabPanel, has_python, sentence

_WARNINGS_SHOWN = 3


class RegionPanel(TabPanel, bpy.types.Panel):
    """Training of the splats in the crop box; all others are frozen"""

    bl_idname = "GSCORE_PT_region"
    bl_label = "Train a Region"
    bl_parent_id = "GSCORE_PT_result"
    bl_options: ClassVar = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A splat object is active, or what crops one."""
        return is_splats(meant(context))

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, ob = self.layout, meant(context)
        job = train_region.job_of(context.scene)
        if job is not None:
            draw_job(layout, context, job)
            if not job.ended:
                return
        if not context.scene.gscore.capture_path.strip():
            text = "Choose the capture of these splats under Capture."
            sentence(layout, context, text, icon="INFO")
            return
        if ob.gscore.crop_object is None:
            sentence(layout, context, "Put a crop box around what is to be trained.", icon="INFO")
            layout.operator("gscore.add_crop_box", icon="CUBE")
            return
        if not has_python(layout, context):
            return
        layout.prop(context.scene.gscore_steer, "region_steps")
        layout.operator("gscore.train_region", icon="PLAY")


def draw_job(layout: bpy.types.UILayout, context: bpy.types.Context, job: RegionJob) -> None:
    """Draw the progress of a training, or its end."""
    if not job.ended:
        row = layout.row(align=True)
        row.progress(factor=job.share, text=bar_text(job))
        row.operator("gscore.stop_region", text="", icon="SNAP_FACE")
        if job.started is not None and (region := job.started.decision("region")):
            sentence(layout, context, region)
    elif job.wanted:
        layout.label(text="Importing the splats...", icon="TIME")
    if job.sentence:
        icon = "ERROR" if job.status == verb_job.FAILED else "CHECKMARK"
        sentence(layout, context, job.sentence, icon=icon)
    for text in job.warnings[-_WARNINGS_SHOWN:]:
        sentence(layout, context, text, icon="ERROR")


def bar_text(job: RegionJob) -> str:
    """Text of the progress bar."""
    if job.start is not None:
        return "Writing the splats"
    told = job.progress
    return "Starting" if told is None or not told.splats else f"Step {told.step:,}"


CLASSES = (RegionPanel,)
