"""Edit panels: selections, clean-up, colours and parts of splats; the brush and its tool in the
toolbar; training of a region.
"""

from typing import Any, ClassVar

import bpy

from ..core import Started
from ..paint.brush import COLOR, OPACITY, SELECT
from ..paint.cursor import draw_circle
from ..paint.modal import RUNNING, PaintSplats
from ..paint.session import STEP
from ..paint.settings import BrushSettings
from ..region_training import train_region
from ..render.viewport_copies import EDITED_AT_ONCE
from ..splats.heal_operators import has_added
from ..splats.objects import active_splats
from ..training.verb_job import VerbJob
from .widgets import SplatsPanel, draw_verb, has_python, sentence


class EditPanel(SplatsPanel, bpy.types.Panel):
    """Manual edits of splats; settings are in the Adjust Last Operation panel at the lower left"""

    bl_idname = "GSCORE_PT_edit"
    bl_label = "Edit Splats"
    bl_parent_id = "GSCORE_PT_result"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, ob = self.layout, active_splats(context)
        large = len(ob.data.vertices) > EDITED_AT_ONCE  # Splats shows edits after Edit Mode only
        if ob.mode == "EDIT" and ob.gscore.display == "SPLATS" and large:
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
        row.operator("gscore.erase_splats", text="Erase")
        row = layout.row(align=True)
        row.operator("gscore.separate_splats", text="Separate")
        row.operator("gscore.join_splats", text="Join")
        row = layout.row(align=True)
        row.operator("gscore.restore_splats", text="Restore")
        row.operator("gscore.replay_edits", text="Replay Edits")
        row = layout.row(align=True)
        row.operator("gscore.heal_splats", text="Heal")
        row.operator("gscore.clone_splats", text="Clone")
        if has_added(context):
            row.operator("gscore.remove_healing", text="Remove Healing")


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
    if brush.does != SELECT:
        layout.prop(brush, "strength")
        layout.prop(brush, "hardness")
    layout.prop(brush, "front_only")
    layout.prop(brush, "only_selected")


_RADIUS = "window_manager.gscore_paint.radius"


def _stroke(**modifiers: bool) -> tuple[str, dict[str, Any], dict[str, Any]]:
    """Keymap item: the mouse begins a stroke."""
    pressed = {"type": "LEFTMOUSE", "value": "PRESS", **modifiers}
    return PaintSplats.bl_idname, pressed, {"properties": [("once", True)]}


def _resize(key: str, factor: float) -> tuple[str, dict[str, Any], dict[str, Any]]:
    """Keymap item: a key scales the brush."""
    scaled = [("data_path", _RADIUS), ("value", factor)]
    pressed = {"type": key, "value": "PRESS", "repeat": True}
    return "wm.context_scale_float", pressed, {"properties": scaled}


class PaintTool(bpy.types.WorkSpaceTool):
    """Paint the active splat object; each drag is a stroke"""

    bl_space_type = "VIEW_3D"
    bl_context_mode = "OBJECT"
    bl_idname = "gscore.paint_tool"
    bl_label = "Paint Splats"
    bl_description = (
        "Paint colors, opacities or the selection of the active splat object; each drag is a stroke"
    )
    bl_icon = "brush.sculpt.paint"
    bl_cursor = "PAINT_CROSS"
    bl_widget = None
    bl_keymap: ClassVar = (
        _stroke(),
        _stroke(ctrl=True),
        _stroke(shift=True),
        (
            "wm.radial_control",
            {"type": "F", "value": "PRESS"},
            {"properties": [("data_path_primary", _RADIUS)]},
        ),
        _resize("LEFT_BRACKET", 1 / STEP),
        _resize("RIGHT_BRACKET", STEP),
    )

    @staticmethod
    def draw_settings(
        context: bpy.types.Context, layout: bpy.types.UILayout, tool: bpy.types.WorkSpaceTool
    ) -> None:
        """Draw the brush settings in the tool's header and sidebar."""
        draw_brush(layout, context.window_manager.gscore_paint)

    @staticmethod
    def draw_cursor(
        context: bpy.types.Context, tool: bpy.types.WorkSpaceTool, place: tuple[int, int]
    ) -> None:
        """Draw the brush's circle around the mouse."""
        brush = context.window_manager.gscore_paint
        draw_circle(place, brush.radius, brush.hardness)


def on_register() -> None:
    """Add the tool after Blender's own tools."""
    bpy.utils.register_tool(PaintTool, separator=True)


def on_unregister() -> None:
    """Remove the tool."""
    bpy.utils.unregister_tool(PaintTool)


class RegionPanel(SplatsPanel, bpy.types.Panel):
    """Train the splats in the crop box again; all others are frozen"""

    bl_idname = "GSCORE_PT_region"
    bl_label = "Train a Region"
    bl_parent_id = "GSCORE_PT_result"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the panel."""
        layout, ob = self.layout, active_splats(context)
        job = train_region.job_of(context.scene)
        if job is not None:
            draw_verb(layout, job, region_text(job), "gscore.stop_region")
            started = job.last(Started)
            if not job.ended and started is not None and (region := started.decision("region")):
                sentence(layout, region)
            if not job.ended:
                return
        if not context.scene.gscore.capture_path.strip():
            sentence(layout, "Choose the capture of these splats under Capture.", icon="INFO")
            return
        has_box, added = ob.gscore.crop_object is not None, has_added(context)
        if not has_box and not added:
            sentence(layout, "Put a crop box around the region to train.", icon="INFO")
            layout.operator("gscore.add_crop_box", icon="CUBE")
            return
        if not has_python(layout):
            return
        layout.prop(context.scene.gscore_steer, "region_steps")
        if has_box:
            layout.operator("gscore.train_region", icon="PLAY")
        if added:
            layout.operator("gscore.train_healed", icon="PLAY")


def region_text(job: VerbJob) -> str:
    """Text of the progress bar."""
    if job.preparing is not None:
        return "Writing the splats"
    last = job.progress
    return "Starting" if last is None or not last.splats else f"Step {last.step:,}"
