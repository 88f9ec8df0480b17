"""Training panel: preset, main options, other options in subpanels, and the Train button; training
of a sequence of captures.
"""

from pathlib import Path
from typing import ClassVar

import bpy

from .. import preferences
from ..cameras.lookup import panel_root, root_from
from ..core import PRESETS, Estimate, FrameStarted, GsError, RunInfo, SequenceFrame, choose_frames
from ..interface.option_labels import error_text
from ..paths import output_folder
from ..render.device import draw_device
from ..sequence import train_sequence
from ..training import facts, forecast, guides, lookups, results, start_training
from ..training.existing_run import EarlierRun
from ..training.options import AS_PRESET, BY_WIDTH, continuation
from ..training.properties import purpose_of
from ..training.verb_job import STOPPING, VerbJob
from .widgets import TabPanel, draw_verb, found, has_python, job, limit, root, rows, sentence

_DETAILS = (
    "strategy",
    "sh_degree",
    "background",
    "antialias",
    "sky",
    "finest",
    "free_space",
    "seed",
)
"""Options at the end of the subpanel."""
_estimates: dict[int, tuple[str, Estimate]] = {}
"""Capture and last estimate of each scene, by session uid."""


class TrainPanel(TabPanel, bpy.types.Panel):
    """Train splats"""

    bl_idname = "GSCORE_PT_train"
    bl_label = "Train"
    bl_order = 3

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, settings = self.layout, context.scene.gscore
        layout.row(align=True).prop(settings, "preset", expand=True)
        sentence(layout, preset_sentence(settings))
        draw_forecast(layout, context)
        known = found(context)
        if settings.use_masks and known is not None and (known.masks or known.alphas):
            text = "Masks are used: masked parts are not trained. See Use Masks under Options."
            sentence(layout, text, icon="INFO")
        column = layout.column(align=True)
        steps = column.row(align=True)
        steps.active = settings.time_budget == 0
        steps.prop(settings, "iterations")
        limit(column, settings, "time_budget")
        column.prop(settings, "max_splats")
        layout.prop(settings, "live_splats")
        layout.prop(settings, "output_path", text="Output")
        draw_output(layout, context)
        draw_buttons(layout, context)


class TrainOptionsPanel(TabPanel, bpy.types.Panel):
    """Options for special cases"""

    bl_idname = "GSCORE_PT_train_options"
    bl_label = "Options"
    bl_parent_id = "GSCORE_PT_train"
    bl_options: ClassVar = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, settings = self.layout, context.scene.gscore
        layout.use_property_split, layout.use_property_decorate = True, False
        column = layout.column()
        column.prop(settings, "resolution")
        if settings.resolution == BY_WIDTH:
            column.prop(settings, "width")
        column = layout.column()
        column.prop(settings, "eval")
        if settings.eval:
            column.prop(settings, "test_every")
        draw_device(layout, preferences.get())
        column = layout.column()
        limit(column, settings, "target_psnr")
        column.prop(settings, "early_stop")
        layout.prop(settings, "train_within")
        column = layout.column()
        column.prop(settings, "use_masks")
        if settings.use_masks:
            column.prop(settings, "mask_mode")
            column.prop(settings, "invert_masks")
        column = layout.column()
        for name in _DETAILS:
            column.prop(settings, name)


class GuidesPanel(TabPanel, bpy.types.Panel):
    """Meshes of the scene that guide the training"""

    bl_idname = "GSCORE_PT_guides"
    bl_label = "Guide Meshes"
    bl_parent_id = "GSCORE_PT_train"
    bl_options: ClassVar = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, settings = self.layout, context.scene.gscore
        layout.use_property_split, layout.use_property_decorate = True, False
        for role, name in guides.ROLES.items():
            row = layout.row(align=True)
            row.prop(settings, name)
            row.operator("gscore.add_guides", text="", icon="ADD").role = role
        used = any(getattr(settings, name) is not None for name in guides.ROLES.values())
        if (
            used
            and panel_root(context.scene) is None
            and not train_sequence.frames_of(context.scene)[0]
        ):
            text = "Import the cameras first, to place these meshes relative to the photos."
            sentence(layout, text, icon="ERROR")


def preset_sentence(settings: bpy.types.PropertyGroup) -> str:
    """Purpose of the chosen preset, and its photo size."""
    text = f"{purpose_of(settings.preset)}."
    if settings.resolution == AS_PRESET:
        width = PRESETS[settings.preset](Path())[0].max_width
        text += f" Photos up to {width} px wide."
    return text


def draw_forecast(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the forecast of the training, and the remedy if it does not fit."""
    scene = context.scene
    known, problem = facts.forecast_of(scene)
    if problem:
        sentence(layout, problem, icon="ERROR")
        return
    capture = scene.gscore.capture_path
    if known is not None:
        _estimates[scene.session_uid] = capture, known
    # Keep the previous estimate until the next one is computed.
    of, current = _estimates.get(scene.session_uid, ("", None))
    if current is None or of != capture or (known is None and found(context) is None):
        return
    text = forecast.warning(current)
    if not text:
        text = forecast.words(current)
        if preferences.uses_card():
            text += " That is for the CPU; the time on a graphics card is not known."
        sentence(layout, text, icon="TIME")
        return
    sentence(layout, text, icon="ERROR")
    row = layout.row(align=True)
    for which, value in (("SPLATS", current.fitting_splats), ("WIDTH", current.fitting_width)):
        if value:
            label = f"Use {value:,} Splats" if which == "SPLATS" else f"Use {value} px Photos"
            row.operator("gscore.fit_training", text=label).which = which


def draw_output(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the default output folder, if the scene has none."""
    settings = context.scene.gscore
    if settings.output_path.strip() or not settings.capture_path.strip():
        return
    try:
        folder = output_folder(context.scene, preferences.get().output_folder)
    except ValueError as error:
        sentence(layout, error_text(error), icon="ERROR")
        return
    sentence(layout, f"Results go to {folder}", icon="FILE_FOLDER")


def draw_buttons(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw Train, or the choices for an existing run, or the reason why training cannot start."""
    running = job(context)
    if running is not None and not running.state.ended:
        layout.label(text="Training; see Progress", icon="TIME")
        return
    before, problem = facts.run(context.scene)
    if before is not None and not before.foreign:
        draw_missing(layout, context, before)
    if not has_python(layout):
        return
    if problem:
        sentence(layout, problem, icon="ERROR")
    if conflict := start_training.box_problem(context.scene.gscore):
        sentence(layout, conflict, icon="ERROR")
    big = layout.column()
    big.scale_y = 1.4
    if before is None:
        captured = found(context)
        if captured is not None and captured.bare:
            sentence(layout, "Find the cameras first, under Capture.", icon="INFO")
        big.enabled = captured is not None and captured.can_train
        big.operator("gscore.train", icon="PLAY")
        return
    if before.foreign:
        sentence(layout, before.foreign_text, icon="ERROR")
        return
    info = before.info
    sentence(layout, run_sentence(info), icon="INFO")
    row = big.row(align=True)
    if can_go_on(context.scene.gscore, info):
        row.operator("gscore.resume_training", icon="PLAY")
    operator = row.operator("gscore.train", text="Start Over", icon="FILE_REFRESH")
    operator.overwrite = True


def draw_missing(
    layout: bpy.types.UILayout, context: bpy.types.Context, before: EarlierRun
) -> None:
    """Draw the import button of a run's splats, if the scene has none or earlier ones."""
    ob = context.scene.gscore.result
    shown = ob is not None and results.is_of_run(ob, before.info.path)
    if shown and results.is_outdated(ob, before):
        sentence(layout, f"{ob.name} has earlier splats of this run.", icon="INFO")
    elif shown or before.info.splats is None:
        return
    layout.operator("gscore.import_result", icon="IMPORT")


def can_go_on(settings: bpy.types.PropertyGroup, info: RunInfo) -> bool:
    """True if a run has steps left, or the settings have more."""
    if info.checkpoint is None or info.problem:
        return False
    try:
        continuation(settings, info)
    except ValueError:
        return False
    return True


def run_sentence(info: RunInfo) -> str:
    """Sentence on the run in the output folder."""
    if info.problem:
        return f"The output folder contains a run that cannot continue: {info.problem}"
    if info.checkpoint is None:
        return "The output folder contains a run without a checkpoint."
    quality = f", PSNR {info.psnr:.2f} dB" if info.psnr is not None else ""
    if info.finished:
        return f"The output folder contains a finished run: {info.steps:,} steps{quality}."
    done = f"step {info.steps:,}" + (f" of {info.iterations:,}" if info.iterations else "")
    return f"The output folder contains a run that was stopped at {done}{quality}."


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
        draw_sequence(layout, context, frames)


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


def draw_sequence(
    layout: bpy.types.UILayout, context: bpy.types.Context, frames: list[SequenceFrame]
) -> None:
    """Draw the bar of a training, or the buttons that start one, and the trained frames."""
    job = train_sequence.job_of(context.scene)
    if job is not None:
        draw_verb(layout, job, sequence_text(job), "gscore.stop_sequence")
        if not job.ended:
            return
    output = train_sequence.output_of(context.scene)
    there, problem = facts.ask(lookups.sequences, output)
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


def sequence_text(job: VerbJob) -> str:
    """Text of the progress bar."""
    if job.status == STOPPING:
        return "Writing a checkpoint"
    frame = job.last(FrameStarted)
    if frame is None:
        return "Starting"
    where = f"Frame {frame.frame}, {frame.place} of {frame.frames}"
    return where if job.progress is None else f"{where}: step {job.progress.step:,}"
