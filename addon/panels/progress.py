"""Progress display: state, curve and buttons of a running or finished training or camera search."""

import sys
from collections.abc import Iterator
from typing import ClassVar

import bpy
import numpy as np

from ..core import FramesDone, headline_psnr, trust_text
from ..interface.base_operator import Condition
from ..interface.images import PictureIcons
from ..region_training import train_region as steer
from ..sequence import train_sequence as sequence
from ..sfm import find_cameras as search_work
from ..splats.objects import is_splats
from ..training import registry, run_state
from ..training.curve import LOSS_COLOR, PSNR_COLOR, Curve
from ..training.training_job import Job
from ..training.verb_job import STOPPING, VerbJob
from . import train
from .edit import region_text
from .widgets import TabPanel, draw_verb, job, rows, sentence

_WARNINGS_SHOWN = 3
_CURVE_SCALE = 6.0


class ProgressPanel(TabPanel, bpy.types.Panel):
    """Progress of the training or of the search for cameras"""

    bl_idname = "GSCORE_PT_progress"
    bl_label = "Progress"
    bl_order = 4
    needs = Condition(lambda context: bool(job(context) or search_work.job_of(context.scene)))

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, current = self.layout, job(context)
        search = search_work.job_of(context.scene)
        if search is not None and (current is None or not search.ended):
            draw_search(layout, search)
            return
        if current is None:
            return
        state = current.state
        draw_numbers(layout, current)
        if state.sentence:
            icon = "ERROR" if state.status == run_state.FAILED else "CHECKMARK"
            sentence(layout, state.sentence, icon=icon)
        if trust := trust_text(state.metrics):
            sentence(layout, trust, icon="CAMERA_DATA")
        if current.silence:
            sentence(layout, current.silence, icon="QUESTION")
        for text in state.warnings[-_WARNINGS_SHOWN:]:
            sentence(layout, text, icon="ERROR")
        if len(state.warnings) > _WARNINGS_SHOWN:
            layout.label(text=f"{len(state.warnings) - _WARNINGS_SHOWN} earlier warnings")
        draw_buttons(layout, context, current)


class DecisionsPanel(TabPanel, bpy.types.Panel):
    """Decisions of the training, made from the capture"""

    bl_idname = "GSCORE_PT_decisions"
    bl_label = "Decisions"
    bl_parent_id = "GSCORE_PT_progress"
    bl_options: ClassVar = {"DEFAULT_CLOSED"}
    needs = Condition(lambda context: bool((now := job(context)) and now.state.decisions))

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        for one in job(context).state.decisions:
            text = f"{one.label}: {one.text}" if one.label else one.text
            sentence(self.layout, text, icon="DOT")


def draw_search(layout: bpy.types.UILayout, search: VerbJob) -> None:
    """Draw an SfM job: its bar with *Cancel*, and its end."""
    draw_verb(layout, search, search_text(search), "gscore.cancel_search", icon="X")
    if not search.ended:
        rows(layout, search_numbers(search))


def search_text(search: VerbJob) -> str:
    """Text of the progress bar of an SfM job."""
    if search.status == STOPPING:
        return "Ending"
    if search.progress is None:
        return "Starting"
    left = "" if search.left is None else f", {clock(search.left)} left"
    return f"{search.progress.phase.capitalize()}{left}"


def search_numbers(search: VerbJob) -> list[tuple[str, str]]:
    """Labels and values of an SfM job."""
    last, pairs = search.progress, []
    if last is not None and last.total:
        pairs.append(("Done", f"{last.done:,} / {last.total:,}"))
    if (frames := search.last(FramesDone)) is not None:
        pairs.append(("Frames", f"{frames.frames:,} of {frames.total:,}"))
    return [*pairs, ("Time", clock(search.elapsed))]


def draw_numbers(layout: bpy.types.UILayout, current: Job) -> None:
    """Draw the curve next to the figures, and the range of each line."""
    state, curve = current.state, current.state.curve
    if state.started is None:
        if not state.ended:
            layout.label(text=f"{bar_text(state)}...", icon="TIME")
        return
    icon = ICONS.update(current)
    if not icon or len(curve.steps) < 2:
        rows(layout, numbers(state))
        return
    split = layout.split(factor=0.45)
    split.template_icon(icon, scale=_CURVE_SCALE)
    rows(split.column(), numbers(state))
    column = layout.column(align=True)
    for line, text in lines(curve).items():
        column.label(text=text, icon_value=ICONS.swatch(line))


def lines(curve: Curve) -> dict[str, str]:
    """Name and range of each line of a curve."""
    losses, psnrs = curve.losses, curve.psnrs
    return {
        LOSS: f"Loss, {min(losses):.3g} to {max(losses):.3g} (logarithmic)",
        PSNR: f"PSNR in training, {min(psnrs):.1f} to {max(psnrs):.1f} dB",
    }


def draw_buttons(layout: bpy.types.UILayout, context: bpy.types.Context, current: Job) -> None:
    """Draw the buttons for the current state of the training."""
    status = current.state.status
    if status in (run_state.RUNNING, run_state.STARTING, run_state.PAUSED):
        row = layout.row(align=True)
        if status == run_state.PAUSED:
            row.operator("gscore.continue_training", icon="PLAY")
        else:
            row.operator("gscore.pause_training", icon="PAUSE")
        row.operator("gscore.stop_training", icon="SNAP_FACE")
        row.operator("gscore.discard_training", icon="TRASH")
    elif status == run_state.STOPPING:
        row = layout.row(align=True)
        row.label(text="Writing a checkpoint...")
        row.operator("gscore.discard_training", text="Do Not Wait", icon="TRASH")
    if current.state.ended and is_splats(context.scene.gscore.result):
        layout.operator("gscore.show_splats", icon="SHADING_RENDERED").trained = True
    row = layout.row(align=True)
    if status in (run_state.RUNNING, run_state.PAUSED):
        row.operator("gscore.update_splats", icon="FILE_REFRESH")
    if context.scene.gscore.preview is not None:
        row.operator("gscore.show_test_view", icon="IMAGE_DATA")


def bar_text(state: run_state.RunState) -> str:
    """Text of the progress bar."""
    if state.status in (run_state.PAUSED, run_state.STOPPING):
        return state.status.capitalize()
    if not state.iterations or state.started is None:
        return state.phase.capitalize()
    left = f", {clock(state.eta_s)} left" if state.eta_s is not None else ""
    return f"{state.share:.0%}{left}"


def numbers(state: run_state.RunState) -> list[tuple[str, str]]:
    """Labels and values of a run."""
    pairs = [("Step", f"{state.step:,} / {state.iterations:,}")]
    if state.loss is not None:
        pairs.append(("Loss", f"{state.loss:.4f}"))
    if (psnr := headline_psnr(state.metrics)) is not None:
        pairs.append(("PSNR", f"{psnr:.2f} dB"))
    elif state.psnr is not None:
        pairs.append(("PSNR", f"{state.psnr:.2f} dB"))
    pairs += [("Splats", f"{state.splats:,}"), ("Device", state.device)]
    if state.ended:
        return [*pairs, ("Time", clock(state.elapsed_s))]
    return [*pairs, ("Speed", f"{state.steps_per_s:.1f} steps/s"), ("Phase", state.phase)]


def clock(seconds: float) -> str:
    """1:02:03 or 2:03; a dash if unknown."""
    if not 0 <= seconds < sys.maxsize:
        return "-"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


_SIZE = 192
_SWATCH = 32
LOSS, PSNR = "loss", "PSNR"
_COLORS = {LOSS: LOSS_COLOR, PSNR: PSNR_COLOR}


class CurveIcons(PictureIcons):
    """Icons: one for each training, and one for each color."""

    def update(self, job: Job) -> int:
        """The icon of a job's curve, drawn again if it has more points; 0 without a window."""
        curve = job.state.curve
        last = curve.steps[-1] if curve.steps else 0
        last_step = job.state.iterations
        return self.show(job.id, last, lambda: curve.picture(_SIZE, _SIZE, last_step=last_step))

    def swatch(self, line: str) -> int:
        """An icon in the color of a line, LOSS or PSNR; 0 without a window."""
        pixels = np.zeros((_SWATCH, _SWATCH, 4), np.float32)
        pixels[_SWATCH // 2 - 3 : _SWATCH // 2 + 3] = (*_COLORS[line], 1)
        return self.show(line, line, lambda: pixels)


ICONS = CurveIcons()
on_register, on_unregister = ICONS.open, ICONS.close


class RunningWorkPanel(TabPanel, bpy.types.Panel):
    """Progress bars of running jobs, above all panels"""

    bl_idname = "GSCORE_PT_now"
    bl_label = "Now"
    bl_order = -1
    bl_options: ClassVar = {"HIDE_HEADER"}
    needs = Condition(
        lambda context: (
            not all(job.state.ended for job in registry.jobs()) or any(other_work(context.scene))
        )
    )

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
    if (found := search_work.job_of(scene)) is not None and not found.ended:
        yield found.share, f"Cameras: {search_text(found)}", "gscore.cancel_search"
    if (region := steer.job_of(scene)) is not None and not region.ended:
        yield region.share, f"Region: {region_text(region)}", "gscore.stop_region"
    if (frames := sequence.job_of(scene)) is not None and not frames.ended:
        yield frames.share, f"Sequence: {train.sequence_text(frames)}", "gscore.stop_sequence"
