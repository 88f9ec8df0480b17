"""Edit panel: selections, clean-up, colours and parts of splats."""

from typing import ClassVar

import bpy

from ..render.viewport_copies import EDITED_AT_ONCE
from ..splats.objects import active_splats, is_splats
from .widgets import TabPanel


def _is_large(ob: bpy.types.Object) -> bool:
    """True if the display Splats shows edits only after Edit Mode."""
    return len(ob.data.vertices) > EDITED_AT_ONCE


class EditPanel(TabPanel, bpy.types.Panel):
    """Manual edits of splats; settings are in the Adjust Last Operation panel at the lower left"""

    bl_idname = "GSCORE_PT_edit"
    bl_label = "Edit Splats"
    bl_parent_id = "GSCORE_PT_result"
    bl_options: ClassVar = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """True if a splat object or its crop object is active."""
        return is_splats(active_splats(context))

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


CLASSES = (EditPanel,)
