"""Paint tool: the brush in the toolbar of the 3D view in Object Mode."""

from typing import Any, ClassVar

import bpy

from ..paint.cursor import draw_circle
from ..paint.modal import PaintSplats
from ..paint.session import STEP
from .edit import draw_brush

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
