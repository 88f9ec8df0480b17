"""Edit panels: selections, clean-up, colours and parts of splats; the brush."""

import bpy

from ..paint.brush import COLOR, OPACITY
from ..paint.modal import RUNNING
from ..paint.settings import BrushSettings
from ..render.viewport_copies import EDITED_AT_ONCE
from ..splats.objects import active_splats
from .widgets import SplatsPanel


def _is_large(ob: bpy.types.Object) -> bool:
    """True if the display Splats shows edits only after Edit Mode."""
    return len(ob.data.vertices) > EDITED_AT_ONCE


class EditPanel(SplatsPanel, bpy.types.Panel):
    """Manual edits of splats; settings are in the Adjust Last Operation panel at the lower left"""

    bl_idname = "GSCORE_PT_edit"
    bl_label = "Edit Splats"
    bl_parent_id = "GSCORE_PT_result"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, ob = self.layout, active_splats(context)
        if ob.mode == "EDIT" and ob.gscore.display == "SPLATS" and _is_large(ob):
            layout.prop_enum(ob.gscore, "display", "POINTS", text="Show Edits Live")
        layout.label(text="Select", icon="RESTRICT_SELECT_OFF")
        row = layout.row(align=True)
        row.operator("gscore.select_by_color", text="Color")
        row.operator("gscore.select_by_opacity", text="Opacity")
        row.operator("gscore.select_by_size", text="Size")
        row = layout.row(align=True)
        row.operator("gscore.select_in_crop", text="In Crop")
        row.operator("gscore.select_flood", text="Flood")
        row.operator("gscore.select_floaters", text="Floaters")
        layout.label(text="Change", icon="MODIFIER")
        row = layout.row(align=True)
        row.operator("gscore.grade_splats", text="Grade")
        row.operator("gscore.decimate_splats", text="Decimate")
        row = layout.row(align=True)
        row.operator("gscore.separate_splats", text="Separate")
        row.operator("gscore.join_splats", text="Join")


class PaintPanel(SplatsPanel, bpy.types.Panel):
    """Brush settings, and the button that starts and ends painting"""

    bl_idname = "GSCORE_PT_paint"
    bl_label = "Paint"
    bl_parent_id = "GSCORE_PT_edit"

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
