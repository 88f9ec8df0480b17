"""Paint panel: the brush for splats."""

from typing import ClassVar

import bpy

from ..paint.brush import COLOR, OPACITY
from ..paint.modal import RUNNING
from ..paint.settings import BrushSettings
from ..splats.objects import active_splats, is_splats
from .widgets import TabPanel


class PaintPanel(TabPanel, bpy.types.Panel):
    """Brush settings, and the button that starts and ends painting"""

    bl_idname = "GSCORE_PT_paint"
    bl_label = "Paint"
    bl_parent_id = "GSCORE_PT_edit"
    bl_options: ClassVar = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """True if a splat object or its crop object is active."""
        return is_splats(active_splats(context))

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, brush = self.layout, context.window_manager.gscore_paint
        layout.use_property_split = True
        layout.use_property_decorate = False
        text = "Paint Splats" if RUNNING.session is None else "Stop Painting"
        layout.operator("gscore.paint_splats", text=text, icon="BRUSH_DATA")
        draw_brush(layout, brush)


def draw_brush(layout: bpy.types.UILayout, brush: BrushSettings) -> None:
    """Draw the effect of the brush and its settings."""
    row = layout.row(align=True)
    row.use_property_split = False  # else the labels are cut off
    row.prop(brush, "does", expand=True)
    if brush.does == COLOR:
        layout.prop(brush, "color")
    elif brush.does == OPACITY:
        layout.prop(brush, "opacity")
    layout.prop(brush, "radius")
    if brush.does in {COLOR, OPACITY}:
        layout.prop(brush, "strength")
        layout.prop(brush, "hardness")
    layout.prop(brush, "front_only")
    layout.prop(brush, "only_selected")


CLASSES = (PaintPanel,)
