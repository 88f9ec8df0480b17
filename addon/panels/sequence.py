"""Sequence panel: the current frame of a played sequence, its range, and problems."""

from typing import ClassVar

import bpy

from ..splats.objects import in_question
from ..timeline import frame_sync
from ..timeline.frame_at import moment_of, series_of
from ..timeline.frames import Series
from ..timeline.library import LIBRARY
from ..timeline.settings import is_sequence
from .widgets import TabPanel, rows, sentence


class SequencePanel(TabPanel, bpy.types.Panel):
    """Playback of the sequence on the timeline"""

    bl_idname = "GSCORE_PT_sequence"
    bl_label = "Sequence"
    bl_parent_id = "GSCORE_PT_result"
    bl_options: ClassVar = set()

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """True if the splats are a sequence."""
        return is_sequence(in_question(context))

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
    pairs = [
        ("Frames", f"{len(series.files):,}: {_range(series)}"),
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


def _range(series: Series) -> str:
    first, last = series.files[0].number, series.files[-1].number
    steps = f", every {series.stride}" if series.stride > 1 else ""
    return f"{first} to {last}{steps}"


def _now(context: bpy.types.Context, ob: bpy.types.Object) -> str:
    moment = moment_of(ob, context.scene.frame_current_final)
    if moment is None:
        return "not playing"
    if moment.hidden:
        return "nothing"
    waits = " (loading)" if moment.waits() else ""
    return f"frame {moment.files[0].number}{waits}" if moment.files else "not known"
