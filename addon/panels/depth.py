"""Depth panel: predict depth maps, compare them with the SfM points, and list the results."""

from typing import ClassVar

import bpy

from .. import preferences
from ..capture.inspection import ShownFacts
from ..depth import colors, networks, predict_depth
from ..interface.option_labels import error_text
from ..training.verb_job import STOPPING, VerbJob
from .depth_table import draw_counts, draw_table
from .progress import clock
from .widgets import TabPanel, draw_verb, found, has_python, root, rows, sentence


class DepthPanel(TabPanel, bpy.types.Panel):
    """Depth maps"""

    bl_idname = "GSCORE_PT_depth"
    bl_label = "Depth"
    bl_order = 2
    bl_options: ClassVar = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, facts = self.layout, found(context)
        if facts is None or not facts.kind:
            layout.label(text="Choose a capture first", icon="INFO")
            return
        maps = f"{facts.depths} of {facts.photos} photos" if facts.depths else "none (depths/)"
        scales = f"{facts.depth_params} entries" if facts.depth_params else "none"
        rows(layout, [("Depth maps", maps), ("Scales", scales)])
        if facts.depths:
            layout.prop(context.scene.gscore, "depth_mode")
        else:
            text = "Depth maps help captures with few photos. A network predicts them."
            sentence(layout, text, icon="INFO")
        draw_work(layout, context, facts)
        draw_report(layout, context)


def draw_work(layout: bpy.types.UILayout, context: bpy.types.Context, facts: ShownFacts) -> None:
    """Draw the progress of a prediction, or the buttons that start one."""
    job = predict_depth.job_of(context.scene)
    if job is not None:
        draw_verb(layout, job, bar_text(job), "gscore.cancel_depth", icon="X")
        if job.busy:
            return
    if not has_python(layout):
        return
    column = layout.column(align=True)
    column.prop(preferences.get(), "depth_network", text="Network")
    if draw_network(column):
        draw_predict(column, facts)
    if facts.depths:
        row = layout.row(align=True)
        row.operator("gscore.check_depth", icon="VIEWZOOM")
        row.operator("gscore.show_depth_sheet", icon="IMAGE_DATA")


def draw_network(layout: bpy.types.UILayout) -> bool:
    """Draw the chosen network: its file, or its size, licence and installation."""
    network = networks.chosen()
    if network is None:
        layout.prop(preferences.get(), "depth_model", text="File")
        return True
    try:
        here = networks.is_installed(network)
    except ValueError as error:
        sentence(layout, error_text(error), icon="ERROR")
        return False
    if here is None:
        layout.label(text="Searching...", icon="TIME")
    elif not here and not networks.may_go_online():
        text = f"Not on this computer ({networks.terms(network)}). {networks.OFFLINE}"
        sentence(layout, text, icon="ERROR")
    elif not here:
        sentence(layout, f"To download: {networks.terms(network)}", icon="INFO")
        button = layout.operator("gscore.predict_depth", text="Download and Predict", icon="IMPORT")
        button.download = True
    return bool(here)


def draw_predict(layout: bpy.types.UILayout, facts: ShownFacts) -> None:
    """Draw the buttons that predict missing maps, or all."""
    row = layout.row(align=True)
    if facts.depths < facts.photos:
        text = "Predict Rest" if facts.depths else "Predict Depth Maps"
        row.operator("gscore.predict_depth", text=text, icon="PLAY")
    if facts.depths:
        again = row.operator("gscore.predict_depth", text="Predict Again", icon="FILE_REFRESH")
        again.overwrite = True


def draw_report(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the table, and the switch of the cameras' colors."""
    scene = context.scene
    problem = predict_depth.run_report(scene)[1]
    if problem:
        sentence(layout, problem, icon="ERROR")
    known = predict_depth.reports(scene)
    if len(known) > 1:
        layout.row(align=True).prop(scene.gscore, "depth_shown", expand=True)
    report = predict_depth.report(scene)
    if report is None:
        return
    if report.why:
        sentence(layout, report.why, icon="INFO")
    draw_counts(layout, report)
    empty = root(context)
    if empty is None:
        sentence(layout, "Import the cameras to color them by their maps.")
    else:
        shown = colors.shown(empty)
        button = layout.operator(
            "gscore.color_cameras", text="Color Cameras", icon="COLOR", depress=shown
        )
        button.show = not shown
    draw_table(layout, context, report)


def bar_text(job: VerbJob) -> str:
    """Text of the progress bar."""
    last = job.progress
    if job.status == STOPPING:
        return "Ending"
    if last is None:
        return "Starting"
    if not last.total:
        return last.phase.capitalize()
    left = f", {clock(last.eta_s)} left" if last.eta_s is not None else ""
    return f"{last.phase.capitalize()} {last.done} of {last.total}{left}"
