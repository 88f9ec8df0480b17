"""Result panel: counts, display, filters and files of the scene's splats; error maps; playback of a
sequence.
"""

from typing import ClassVar

import bpy

from .. import attributes, stored_paths
from ..cameras.objects import cameras_of, root_of
from ..capture.figures import Figures
from ..error_maps import measure_errors
from ..histograms import gizmos
from ..histograms.counting import OPACITY, SIZE
from ..histograms.histogram_cache import ICONS
from ..interface.base_operator import Condition
from ..interface.option_labels import error_text
from ..live import draw_handler
from ..render.lamps import light_of_world
from ..splats import edit, lag, live_display, operators
from ..splats.error_maps import is_map
from ..splats.mend_operators import outdated
from ..splats.objects import (
    active_splats,
    has_splats,
    has_trained,
    in_question,
    is_native,
    is_relit,
)
from ..surface import fit_proxy, make_mesh
from ..timeline import frame_sync
from ..timeline.frame_at import moment_of, series_of
from ..timeline.library import LIBRARY
from ..timeline.settings import is_sequence
from ..training import facts, lookups
from ..training.verb_job import VerbJob
from ..viewers import refit
from .widgets import (
    SplatsPanel,
    TabPanel,
    draw_verb,
    has_python,
    job,
    limit,
    python_problem,
    rows,
    sentence,
)

_HISTOGRAM_SCALE = 4.0
"""Height of a histogram, in buttons."""


class ResultPanel(TabPanel, bpy.types.Panel):
    """The splats"""

    bl_idname = "GSCORE_PT_result"
    bl_label = "Result"
    bl_order = 5

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, ob = self.layout, in_question(context)
        if is_native(context.object):
            draw_native(layout, context)
            return
        if ob is None:
            sentence(layout, "No splats yet: train some, or import a PLY.", icon="INFO")
            layout.operator("gscore.import_splats", icon="IMPORT")
            layout.operator("gscore.import_sequence", icon="RENDER_ANIMATION")
            return
        row = layout.row(align=True)
        row.label(text=ob.name, icon="OUTLINER_OB_POINTCLOUD")
        if ob != active_splats(context):
            row.operator("gscore.select_result", text="Select")
        draw_counts(layout, context, ob)
        draw_outdated(layout, context)
        if not operators.is_even(ob):
            text = "The object's scale differs between axes or is zero; splats cannot be stretched."
            sentence(layout, text, icon="ERROR")
            layout.operator("gscore.make_scale_even")
        settings = ob.gscore
        layout.prop(settings, "display")
        is_live = settings.display == "SPLATS"
        if is_live:
            if problem := draw_handler.problem_of(_main_region(context)):
                sentence(layout, problem, icon="ERROR")
            elif not live_display.SESSION.works:
                sentence(layout, "Splats are drawn live only in a window.", icon="INFO")
        else:
            layout.prop(settings, "colour_by")
            draw_viewpoint(layout, context, ob)
            draw_refit(layout, context, ob)
        shading = context.space_data.shading
        if shading.type in {"WIREFRAME", "SOLID"} and not is_live:  # these color only faces
            layout.prop_enum(shading, "type", "MATERIAL", text="Show Colors in This View")
        if settings.display == "POINTS":
            layout.prop(settings, "point_size")
        elif settings.display in {"ELLIPSOIDS", "SOFT"}:
            layout.prop(settings, "ellipsoid_size")
        layout.operator("gscore.show_splats", icon="SHADING_RENDERED")
        row = layout.row(align=True)
        row.operator("gscore.import_splats", text="Import", icon="IMPORT")
        row.operator("gscore.export_splats", text="Export", icon="EXPORT")
        row.operator("gscore.import_sequence", text="", icon="RENDER_ANIMATION")
        training = job(context)
        if stored_paths.RUN in ob and (training is None or training.state.ended):
            layout.operator("gscore.show_report", icon="URL")


def draw_native(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the buttons for splats that Blender imported."""
    ob = context.object
    layout.label(text=ob.name, icon="OUTLINER_OB_POINTCLOUD")
    rows(layout, [("Splats", f"{len(ob.data.points):,}")])
    text = "Blender's own splats. Gaussian Splats renders them; filters and tools need a copy."
    sentence(layout, text, icon="INFO")
    layout.operator("gscore.take_native_splats", icon="IMPORT")
    layout.operator("gscore.export_splats", text="Export", icon="EXPORT")


def draw_outdated(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw problems from Blender's Apply or Join in the selected splats, and the repair button."""
    problems = {ob.name: lag.problem(ob.data) for ob in outdated(context)}
    for text in dict.fromkeys(problems.values()):
        names = ", ".join(name for name, own in problems.items() if own == text)
        sentence(layout, text.format(names), icon="ERROR")
    if problems:
        kept = set(problems.values()) == {lag.JOINED}
        text = "Keep as It Is" if kept else "Update Shapes and Colors"
        layout.operator("gscore.mend_splats", text=text, icon="MODIFIER")


class FiltersPanel(TabPanel, bpy.types.Panel):
    """Filters that hide splats, and actions on the hidden ones"""

    bl_idname = "GSCORE_PT_filters"
    bl_label = "Filters"
    bl_parent_id = "GSCORE_PT_result"
    bl_options: ClassVar = {"DEFAULT_CLOSED"}
    needs = Condition(lambda context: in_question(context) is not None)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, ob = self.layout, in_question(context)
        settings = ob.gscore
        draw_limits(layout, ob)
        switch = context.window_manager  # of the histograms in the view, with handles to drag
        layout.prop(switch, "gscore_histograms", icon="ARROW_LEFTRIGHT")
        if switch.gscore_histograms and (text := gizmos.problem(context, _main_region(context))):
            sentence(layout, text, icon="INFO")
        column = layout.column(align=True)
        column.prop(settings, "crop_object", text="Crop")
        if settings.crop_object is not None:
            row = column.row(align=True)
            row.prop(settings, "crop_shape", text="")
            row.prop(settings, "crop_invert", toggle=True)
            if not settings.crop_object.users_scene:  # a setting keeps a deleted object
                text = "The crop object was deleted, but still crops; press Reset to end that."
                sentence(layout, text, icon="INFO")
        layout.prop(settings, "apply_filters_to_render")
        if ob != active_splats(context):
            return
        if settings.crop_object is None:
            layout.operator("gscore.add_crop_box", icon="CUBE")
        row = layout.row(align=True)
        row.operator("gscore.reset_filters", text="Reset")
        row.operator("gscore.select_splats", text="Select Hidden").which = "HIDDEN"
        layout.operator("gscore.apply_filters", icon="TRASH")


class MorePanel(SplatsPanel, bpy.types.Panel):
    """Less common actions"""

    bl_idname = "GSCORE_PT_result_more"
    bl_label = "More"
    bl_parent_id = "GSCORE_PT_result"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        layout.operator("gscore.apply_splat_transform")
        layout.operator("gscore.reset_display")


def draw_limits(layout: bpy.types.UILayout, ob: bpy.types.Object) -> None:
    """Draw histograms of opacity and size, and below them the limits, in full width because their
    labels are long."""
    icons = {kind: ICONS.update(ob, kind) for kind in (OPACITY, SIZE)}
    if any(icons.values()):
        row = layout.row()
        for kind, icon in icons.items():
            column = row.column(align=True)
            column.label(text=f"By {kind}")
            column.template_icon(icon, scale=_HISTOGRAM_SCALE)
    column = layout.column(align=True)
    for name in ("opacity_min", "size_min", "size_max"):
        limit(column, ob.gscore, name)


def _main_region(context: bpy.types.Context) -> bpy.types.Region:
    return next(one for one in context.area.regions if one.type == "WINDOW")


def draw_viewpoint(
    layout: bpy.types.UILayout, context: bpy.types.Context, ob: bpy.types.Object
) -> None:
    """Draw a note on the viewpoint of soft splats' colors: a modifier's nodes know only the scene
    camera, because their result is shared by all views."""
    settings = ob.gscore
    soft = settings.display == "SOFT" and settings.colour_by == "COLOR"
    if not soft or f"{attributes.SH}0" not in ob.data.attributes:
        return
    text = "All views show the colors as seen from the scene camera."
    if context.scene.camera is None:
        text = "Without a scene camera the colors do not depend on the view."
    sentence(layout, text, icon="INFO")


_BRIGHTER = (
    "Blender blends native splats in linear light, so they are brighter than by the engine "
    "Gaussian Splats, often by 2 to 7 of 255."
)
_FITTED = (
    "These splats are fitted to {}, for pictures of the size of the training's photos. For other "
    "engines show the splats of the training, which were hidden."
)


def phase_text(job: VerbJob) -> str:
    """Text of the bar of a job whose progress has a phase."""
    return "Starting" if job.progress is None else job.progress.phase.capitalize()


def draw_refit(
    layout: bpy.types.UILayout, context: bpy.types.Context, ob: bpy.types.Object
) -> None:
    """Draw how Blender draws native splats, and the button that fits the splats to it."""
    if ob.gscore.display != "NATIVE" or is_map(ob):
        return
    fitted = refit.fitted_to(ob)
    sentence(layout, _FITTED.format(fitted) if fitted else _BRIGHTER, icon="INFO")
    job = refit.job_of(ob)
    if job is not None:
        draw_verb(layout, job, phase_text(job), "gscore.stop_refit")
    if fitted or (job is not None and job.busy) or python_problem():
        return
    if stored_paths.RUN not in ob:
        sentence(layout, "Only splats of a training can be refitted: it needs their photos.")
    layout.operator("gscore.refit_splats", icon="SHADING_RENDERED")


def draw_counts(
    layout: bpy.types.UILayout, context: bpy.types.Context, ob: bpy.types.Object
) -> None:
    """Draw the number of splats, and of those that the filters show."""
    try:
        counts = edit.stats(ob, context.evaluated_depsgraph_get())
    except ValueError as error:
        sentence(layout, error_text(error), icon="ERROR")
        return
    visible = "not known" if counts.visible is None else f"{counts.visible:,}"
    pairs = [("Splats", f"{counts.total:,}"), ("Shown", visible)]
    rows(layout, [*pairs, ("Color degree", str(counts.sh_degree))])
    if counts.total and counts.visible == 0:
        text = "Filters hide all splats; press Reset under Filters to show them."
        sentence(layout, text, icon="ERROR")


_WORST = 5
"""Number of photos in the list."""
_COLORS = (
    "Cameras: dark violet for the best photo, pale yellow for the worst. Splats: black for no "
    "error, pale yellow for errors of {:.0%} or more, gray for splats that no photo shows."
)


class SurfacePanel(TabPanel, bpy.types.Panel):
    """The surface of the splats as a mesh"""

    bl_idname = "GSCORE_PT_surface"
    bl_label = "Surface"
    bl_parent_id = "GSCORE_PT_result"
    bl_options: ClassVar = {"DEFAULT_CLOSED"}
    needs = Condition(has_trained)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout = self.layout
        job = make_mesh.job_of(active_splats(context))
        if job is not None:
            draw_verb(layout, job, phase_text(job), "gscore.stop_mesh")
            if job.busy:
                return
        if has_python(layout):
            layout.operator("gscore.make_mesh", icon="MESH_ICOSPHERE")
            proxy = layout.operator("gscore.make_mesh", text="Make Proxy", icon="MOD_SUBSURF")
            proxy.proxy, proxy.triangles = True, 50_000
        if fit_proxy.is_stale(active_splats(context)):
            text = "The splats have changed since their proxy was made. After a training or a "
            text += "restoration, make it again; after other edits, update it."
            sentence(layout, text, icon="INFO")
            layout.operator("gscore.update_proxy", icon="FILE_REFRESH")


class LightPanel(TabPanel, bpy.types.Panel):
    """Light of the scene on the splats"""

    bl_idname = "GSCORE_PT_light"
    bl_label = "Light"
    bl_parent_id = "GSCORE_PT_result"
    bl_options: ClassVar = {"DEFAULT_CLOSED"}
    needs = Condition(has_splats)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, ob = self.layout, active_splats(context)
        layout.operator("gscore.relight_splats", icon="LIGHT")
        column = layout.column()
        column.active = bool(attributes.light_names(ob.data))
        column.prop(ob.gscore, "light", slider=True)
        lamps = any(one.type == "LIGHT" for one in context.scene.objects)
        if is_relit(ob) and not lamps and not light_of_world(context.scene.world).any():
            text = "The scene has no lamp and a black world, so relit splats are black."
            sentence(layout, text, icon="INFO")


class ErrorsPanel(TabPanel, bpy.types.Panel):
    """Differences between the result and its photos"""

    bl_idname = "GSCORE_PT_errors"
    bl_label = "Error Maps"
    bl_parent_id = "GSCORE_PT_result"
    bl_options: ClassVar = {"DEFAULT_CLOSED"}
    needs = Condition(has_trained)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, ob = self.layout, active_splats(context)
        job = measure_errors.job_of(ob)
        if job is not None:
            text = job.progress.view if job.progress is not None else ""
            draw_verb(layout, job, text or "Starting", "gscore.stop_errors")
            if job.busy:
                return
            if job.done is not None:
                sentence(layout, _COLORS.format(job.done.error_bright))
        if has_python(layout):
            layout.operator("gscore.measure_errors", icon="VIEWZOOM")
        figures, problem = facts.ask(lookups.figures, measure_errors.run_of(ob))
        if problem:
            sentence(layout, problem, icon="ERROR")
        draw_switches(layout, ob, figures)
        if figures is not None:
            draw_worst(layout, ob, figures)


def draw_switches(
    layout: bpy.types.UILayout, ob: bpy.types.Object, figures: Figures | None
) -> None:
    """Draw the switches of the colors."""
    root, maps = root_of(ob), measure_errors.siblings(ob)[1]
    colored = root is not None and measure_errors.are_colored(root)
    if not maps and not colored and figures is None:
        return
    row = layout.row(align=True)
    part = row.row(align=True)
    part.enabled = root is not None and (colored or figures is not None)
    cameras = part.operator("gscore.color_by_error", text="Cameras", icon="COLOR", depress=colored)
    cameras.show = not colored
    part = row.row(align=True)
    part.enabled = bool(maps)
    shown = any(other.visible_get() for other in maps)
    splats = part.operator("gscore.show_error_map", text="Splats", icon="COLOR", depress=shown)
    splats.show = not shown
    row.operator("gscore.remove_errors", text="", icon="X")


def draw_worst(layout: bpy.types.UILayout, ob: bpy.types.Object, figures: Figures) -> None:
    """Draw the worst photos, with buttons for their camera views and the comparison."""
    root = root_of(ob)
    cameras = {} if root is None else {c.get("gs_image"): c.name for c in cameras_of(root)}
    column = layout.column(align=True)
    for name, psnr in figures.ranked[:_WORST]:
        row = column.row(align=True)
        row.label(text=f"{psnr:.1f} dB  {name}")
        part = row.row(align=True)
        part.enabled = name in cameras
        look = part.operator("gscore.use_camera", text="", icon="VIEW_CAMERA")
        look.camera = name
        compare = part.operator("gscore.compare_photo", text="", icon="IMAGE_REFERENCE")
        compare.camera = cameras.get(name, "")


class SequencePanel(TabPanel, bpy.types.Panel):
    """Playback of the sequence on the timeline"""

    bl_idname = "GSCORE_PT_sequence"
    bl_label = "Sequence"
    bl_parent_id = "GSCORE_PT_result"
    bl_options: ClassVar = set()
    needs = Condition(lambda context: is_sequence(in_question(context)))

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, ob = self.layout, in_question(context)
        settings = ob.gscore_sequence
        if settings.edited:
            text = "These splats were edited, so playback has stopped to keep them."
            sentence(layout, text, icon="INFO")
            layout.operator("gscore.play_again", icon="PLAY")
        draw_frames(layout, context, ob)
        layout.prop(settings, "folder", text="")
        if settings.files:
            layout.prop(settings, "files")
        column = layout.column(align=True)
        for name in ("start", "offset", "speed", "step"):
            column.prop(settings, name)
        layout.prop(settings, "beyond")
        row = layout.row(align=True)
        row.operator("gscore.keep_frame", icon="DUPLICATE")
        row.operator("gscore.look_at_frames_again", text="", icon="FILE_REFRESH")


def draw_frames(
    layout: bpy.types.UILayout, context: bpy.types.Context, ob: bpy.types.Object
) -> None:
    """Draw the number of frames, the shown one, and the reason why another is not shown."""
    series, problem = series_of(ob)
    if series is None:
        text = problem or "Searching for frames..."
        sentence(layout, text, icon="ERROR" if problem else "TIME")
        return
    count, size = LIBRARY.loaded
    first, last = series.files[0].number, series.files[-1].number
    steps = f", every {series.stride}" if series.stride > 1 else ""
    pairs = [
        ("Frames", f"{len(series.files):,}: {first} to {last}{steps}"),
        ("Now", _now(context, ob)),
        ("In memory", f"{count}, {size / 1e6:,.0f} MB"),
    ]
    rows(layout, pairs)
    if series.gaps:
        sentence(layout, series.gap_text(), icon="ERROR")
    moment = moment_of(ob, context.scene.frame_current_final)
    damaged = LIBRARY.frame(moment.files[0])[1] if moment is not None and moment.files else ""
    if text := damaged or frame_sync.problem_of(ob):
        sentence(layout, text, icon="ERROR")
    elif ob.library is not None or not ob.data.is_editable:
        text = "Linked: EEVEE and Cycles show the frame that was saved in its file."
        sentence(layout, text, icon="INFO")


def _now(context: bpy.types.Context, ob: bpy.types.Object) -> str:
    moment = moment_of(ob, context.scene.frame_current_final)
    if moment is None:
        return "not playing"
    if moment.hidden:
        return "nothing"
    waits = " (loading)" if moment.waits() else ""
    return f"frame {moment.files[0].number}{waits}" if moment.files else "not known"
