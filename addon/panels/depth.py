"""Depth panel: predict depth maps, compare them with the SfM points, and list the results with a
row for each view, and the figures of one view.

Blender's lists show collections of properties. These belong to the window manager, which is neither
saved nor undone, and are filled by the first poll after the report is read.
"""

from typing import Any, ClassVar

import bpy
from bpy.props import BoolProperty, CollectionProperty, IntProperty, PointerProperty, StringProperty

from .. import preferences
from ..capture import depth_maps
from ..capture.depth_maps import DepthReport, DepthRow
from ..capture.inspection import ShownFacts
from ..depth import colors, networks, predict_depth
from ..interface.option_labels import error_text
from ..process import poll_timer
from ..training.verb_job import STOPPING, VerbJob
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


ICONS = {
    depth_maps.ACCEPTED: "COLLECTION_COLOR_04",
    depth_maps.REFUSED: "COLLECTION_COLOR_01",
    depth_maps.MISSING: "OUTLINER_COLLECTION",
    depth_maps.UNKNOWN: "QUESTION",
}
"""Icons in the camera colors of `depth.colors`."""
WORDS = {
    depth_maps.ACCEPTED: "accepted",
    depth_maps.REFUSED: "refused",
    depth_maps.MISSING: "without a map",
    depth_maps.UNKNOWN: "not compared yet",
}
_MOST_TABLES = 8
_WIDE = 300
"""Smallest sidebar width for a further column, pixels at a scale of 1."""

_filled: dict[str, DepthReport] = {}
"""The report in the table of each scene."""


class DepthItem(bpy.types.PropertyGroup):
    """A row; `name` is the view's, the numbers are in the report."""

    verdict: StringProperty(name="Map", description="State of the depth map of the view")


class DepthTable(bpy.types.PropertyGroup):
    """The table of a scene; `name` is the scene's."""

    views: CollectionProperty(type=DepthItem)
    active: IntProperty(name="View", description="View whose figures are shown below")


class DepthTables(bpy.types.PropertyGroup):
    """`WindowManager.gscore_depth`."""

    tables: CollectionProperty(type=DepthTable)


class GSCORE_UL_depth(bpy.types.UIList):  # noqa: N801 Blender's rule
    """The views of a depth report"""

    problems: BoolProperty(
        name="Not Accepted Only",
        description="Show only views whose map is rejected, missing or not compared yet",
    )

    def draw_item(
        self,
        context: bpy.types.Context,
        layout: bpy.types.UILayout,
        data: Any,
        item: DepthItem,
        icon: int,
        active_data: Any,
        active_property: str,
    ) -> None:
        """Draw a row: name, fit and inliers."""
        report = _filled.get(data.name)
        row = report.by_view.get(item.name) if report is not None else None
        if row is None:
            layout.label(text=item.name)
            return
        split = layout.split(factor=0.46)
        split.label(text=row.name, icon=ICONS[row.verdict])
        cells = split.row()
        for text in cells_of(row, wide=_width(context) >= _WIDE):
            cells.label(text=text)

    def draw_filter(self, context: bpy.types.Context, layout: bpy.types.UILayout) -> None:
        """Draw the search."""
        row = layout.row(align=True)
        row.prop(self, "filter_name", text="")
        row.prop(self, "problems", text="", icon="ERROR")

    def filter_items(
        self, context: bpy.types.Context, data: Any, name: str
    ) -> tuple[list[int], list[int]]:
        """Flags of the shown rows, and no reordering."""
        items = getattr(data, name)
        flags = [self.bitflag_filter_item] * len(items)
        if self.filter_name:
            flags = bpy.types.UI_UL_list.filter_items_by_name(
                self.filter_name, self.bitflag_filter_item, items
            )
        if self.problems:
            problems = [item.verdict != depth_maps.ACCEPTED for item in items]
            flags = [flag if bad else 0 for flag, bad in zip(flags, problems, strict=True)]
        return flags, []


def cells_of(row: DepthRow, *, wide: bool) -> list[str]:
    """Cells next to the name of a view."""
    inliers = "-" if row.inliers is None else f"{row.inliers:.0%}"
    return (
        [row.fit, inliers]
        if wide or row.verdict != depth_maps.ACCEPTED
        else [
            f"{row.scale:.4g}" if row.scale is not None else "-",
            inliers,
        ]
    )


def draw_counts(layout: bpy.types.UILayout, report: DepthReport) -> None:
    """Draw the number of views of each verdict, with icons in their colors."""
    column = layout.column(align=True)
    column.scale_y = 0.8
    for verdict, icon in ICONS.items():
        if report.counts[verdict]:
            column.label(text=f"{report.counts[verdict]} {WORDS[verdict]}", icon=icon)


def draw_table(layout: bpy.types.UILayout, context: bpy.types.Context, report: DepthReport) -> None:
    """Draw the list, and the numbers of the chosen view."""
    table = table_of(context)
    if table is None or _filled.get(table.name) is not report:
        poll_timer.ensure()
        layout.label(text="Filling the table...", icon="TIME")
        return
    column = layout.column(align=True)
    head = column.split(factor=0.46)
    head.label(text="View")
    cells = head.row()
    cells.label(text="Scale, Offset" if _width(context) >= _WIDE else "Scale")
    cells.label(text="Inliers")
    column.template_list("GSCORE_UL_depth", "", table, "views", table, "active", rows=5)
    if 0 <= table.active < len(table.views):
        chosen = report.by_view.get(table.views[table.active].name)
        if chosen is not None:
            draw_view(layout.box(), chosen)


def draw_view(layout: bpy.types.UILayout, row: DepthRow) -> None:
    """Draw the numbers of one view."""
    head = layout.row(align=True)
    head.label(text=row.view, icon=ICONS[row.verdict])
    button = head.operator("gscore.use_camera", text="", icon="VIEW_CAMERA")
    button.camera = row.view
    rows(layout, row.lines())
    if row.reason:
        sentence(layout, f"{row.reason[0].upper()}{row.reason[1:]}.")


def table_of(context: bpy.types.Context) -> DepthTable | None:
    """The table of the context's scene, if it was filled."""
    return context.window_manager.gscore_depth.tables.get(context.scene.name)


def fill() -> bool:
    """Update the tables of all windows' scenes; True if anything changed."""
    manager = bpy.context.window_manager
    changed = False
    for scene in {window.scene for window in manager.windows} or {bpy.context.scene}:
        report = predict_depth.report(scene)
        tables = manager.gscore_depth.tables
        table = tables.get(scene.name)
        done = table is not None and len(table.views) == len(report.rows) if report else True
        if report is None or (done and _filled.get(scene.name) is report):
            continue
        if table is None:
            while len(tables) >= _MOST_TABLES:
                tables.remove(0)
            table = tables.add()
            table.name = scene.name
        _fill(table, report)
        _filled[scene.name] = report
        changed = True
    return changed


def _fill(table: DepthTable, report: DepthReport) -> None:
    names = [item.name for item in table.views]
    if names != [row.view for row in report.rows]:
        table.views.clear()
        for row in report.rows:
            table.views.add().name = row.view
        table.active = next(
            (i for i, row in enumerate(report.rows) if row.verdict == depth_maps.REFUSED), 0
        )
    for item, row in zip(table.views, report.rows, strict=True):
        item.verdict = row.verdict


def _width(context: bpy.types.Context) -> float:
    """Width of the sidebar, pixels at a scale of 1."""
    width = context.region.width if context.region else 260
    return width / (context.preferences.system.ui_scale or 1.0)  # 0 without a window


_POLLER = poll_timer.Poller(fill)
PROPERTIES = ((bpy.types.WindowManager, "gscore_depth", PointerProperty(type=DepthTables)),)
APPENDED = ((poll_timer.POLLERS, _POLLER),)


def on_unregister() -> None:
    """Forget the tables."""
    _filled.clear()
