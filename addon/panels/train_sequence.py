"""Sequence training panel: frames to train, progress, and existing results."""

from typing import ClassVar

import bpy

from ..cameras.lookup import root_from
from ..core import FrameStarted, GsError, SequenceFrame, choose_frames
from ..interface.option_labels import error_text
from ..sequence import train_sequence
from ..training import guides
from ..training.verb_job import STOPPING, VerbJob
from .widgets import TabPanel, draw_verb, has_python, root, rows, sentence


class TrainSequencePanel(TabPanel, bpy.types.Panel):
    """Frames of a multi-view video, one after the other"""

    bl_idname = "GSCORE_PT_train_sequence"
    bl_label = "Sequence of Captures"
    bl_parent_id = "GSCORE_PT_train"
    bl_options: ClassVar = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, scene = self.layout, context.scene
        if not scene.gscore.capture_path.strip():
            sentence(layout, "Choose the folder of the frames under Capture.", icon="INFO")
            return
        frames, problem = train_sequence.frames_of(scene)
        if problem:
            sentence(layout, problem, icon="INFO")
            return
        if frames is None:
            layout.label(text="Searching for frames...", icon="TIME")
            return
        numbers = f"{frames[0].number} to {frames[-1].number}"
        rows(layout, [("Frames", f"{len(frames):,}: {numbers}")])
        own = scene.gscore_train_sequence
        for name in ("frames", "next_iterations", "warm_start"):
            layout.prop(own, name)
        draw_guides(layout, context, frames)
        draw_state(layout, context, frames)


def draw_guides(
    layout: bpy.types.UILayout, context: bpy.types.Context, frames: list[SequenceFrame]
) -> None:
    """Draw the guide meshes of a sequence, used once the cameras are imported."""
    scene = context.scene
    own, within = scene.gscore_train_sequence, scene.gscore.train_within
    if within is not None:
        sentence(layout, train_sequence.ONLY_WITHIN.format(within.name), icon="INFO")
    if not any(guides.chosen(scene)):
        return
    layout.prop(own, "guide_start")
    try:
        first = choose_frames(frames, own.frames.strip() or ":")[0]
    except GsError as error:
        sentence(layout, error_text(error), icon="ERROR")
        return
    if root_from(scene, first.data.source) is None:
        text = f"Guide meshes need the cameras of frame {first.number}: import them."
        sentence(layout, text, icon="ERROR")
        row = layout.operator("gscore.import_cameras", text=f"Import Frame {first.number}")
        row.directory, row.images = str(first.data.source), first.data.images


def draw_state(
    layout: bpy.types.UILayout, context: bpy.types.Context, frames: list[SequenceFrame]
) -> None:
    """Draw the bar of a training, or the buttons that start one, and the trained frames."""
    job = train_sequence.job_of(context.scene)
    if job is not None:
        draw_verb(layout, job, bar_text(job), "gscore.stop_sequence")
        if not job.ended:
            return
    output = train_sequence.output_of(context.scene)
    there, problem = train_sequence.trained_in(output)
    if problem:
        sentence(layout, problem, icon="ERROR")
    if there is not None and there.frames:
        count, total = len(there.frames), there.mean.get("frames_total") or len(there.frames)
        sentence(layout, f"{count:,} of {total:,} frames are trained.", icon="INFO")
        bring = layout.operator("gscore.import_sequence", icon="IMPORT")
        bring.directory = str(output)
        empty = root_from(context.scene, frames[0].data.source) or root(context)
        bring.capture = empty.name if empty is not None else ""
    sentence(layout, f"Results go to {output}", icon="FILE_FOLDER")
    if not has_python(layout):
        return
    big = layout.row(align=True)
    big.scale_y = 1.4
    if there is None and not train_sequence.is_started(output):
        big.operator("gscore.train_sequence", icon="PLAY")
        return
    big.operator("gscore.train_sequence", text="Resume", icon="PLAY").resume = True
    over = big.operator("gscore.train_sequence", text="Start Over", icon="FILE_REFRESH")
    over.overwrite = True


def bar_text(job: VerbJob) -> str:
    """Text of the progress bar."""
    if job.status == STOPPING:
        return "Writing a checkpoint"
    frame = job.last(FrameStarted)
    if frame is None:
        return "Starting"
    where = f"Frame {frame.frame}, {frame.place} of {frame.frames}"
    return where if job.progress is None else f"{where}: step {job.progress.step:,}"
