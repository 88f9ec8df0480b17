"""Error maps panel: photo errors on cameras, pixel errors on splats, and the worst photos."""

from typing import ClassVar

import bpy

from ..cameras.objects import cameras_of, root_of
from ..capture.figures import Figures
from ..error_maps import measure_errors
from ..process import poll_timer
from ..splats.objects import active_splats, is_splats
from ..stored_paths import RUN
from ..training import lookups
from .widgets import TabPanel, draw_verb, has_python, sentence

_WORST = 5
"""Number of photos in the list."""
_COLORS = (
    "Cameras: dark violet for the best photo, pale yellow for the worst. Splats: black for no "
    "error, pale yellow for errors of {:.0%} or more, grey for splats that no photo shows."
)


class ErrorsPanel(TabPanel, bpy.types.Panel):
    """Differences between the result and its photos"""

    bl_idname = "GSCORE_PT_errors"
    bl_label = "Error Maps"
    bl_parent_id = "GSCORE_PT_result"
    bl_options: ClassVar = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """True if splats of a training are active."""
        return is_splats(ob := active_splats(context)) and RUN in ob

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
        figures, problem = lookups.figures.get(measure_errors.run_of(ob))
        poll_timer.ensure()  # collects the lookup
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
