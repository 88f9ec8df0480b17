"""Running work: progress bars above all panels, for trainings of any file and jobs of the scene."""

from collections.abc import Iterator
from typing import ClassVar

import bpy

from ..region_training import train_region as steer
from ..sequence import train_sequence as sequence
from ..sfm import find_cameras as search
from ..training import registry
from ..training.training_job import Job
from . import progress, train_sequence
from . import region_training as steer_panel
from .progress import bar_text
from .widgets import TabPanel, job


class RunningWorkPanel(TabPanel, bpy.types.Panel):
    """Progress bars of running jobs, above all panels"""

    bl_idname = "GSCORE_PT_now"
    bl_label = "Now"
    bl_order = -1
    bl_options: ClassVar = {"HIDE_HEADER"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """True while a job is running."""
        trains = any(not job.state.ended for job in registry.jobs())
        return trains or any(True for _ in other_work(context.scene))

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        own = job(context)
        if own is not None and not own.state.ended:
            draw_bar(self.layout, own, "Training")
        for other in registry.jobs():
            if other is not own and not other.state.ended:
                row = draw_bar(self.layout, other, other.source.name)
                show = row.operator("gscore.follow_training", text="", icon="RESTRICT_SELECT_OFF")
                show.job_id = other.id
        for share, text, stop in other_work(context.scene):
            row = self.layout.row(align=True)
            row.progress(factor=share, text=text)
            row.operator(stop, text="", icon="X")


def draw_bar(layout: bpy.types.UILayout, current: Job, name: str) -> bpy.types.UILayout:
    """Draw a training's bar and the button that stops it; returns their row."""
    row = layout.row(align=True)
    row.progress(factor=current.state.share, text=f"{name}: {bar_text(current.state)}")
    row.operator("gscore.stop_training", text="", icon="SNAP_FACE").job_id = current.id
    return row


def other_work(scene: bpy.types.Scene) -> Iterator[tuple[float, str, str]]:
    """Other running jobs of a scene: progress, text, and the operator that stops each."""
    if (found := search.job_of(scene)) is not None and not found.ended:
        yield found.share, f"Cameras: {progress.search_text(found)}", "gscore.cancel_search"
    if (region := steer.job_of(scene)) is not None and not region.ended:
        yield region.share, f"Region: {steer_panel.bar_text(region)}", "gscore.stop_region"
    if (frames := sequence.job_of(scene)) is not None and not frames.ended:
        yield frames.share, f"Sequence: {train_sequence.bar_text(frames)}", "gscore.stop_sequence"
