"""The brush as a tool of the 3D view. Oracle: Blender's own list of tools, operators and their
properties."""

from types import SimpleNamespace

import bpy
from bl_ui.space_toolsystem_common import ToolSelectPanelHelper

from addon.panels.edit import PaintTool
from tests.addon.drawn import Layout


def tools() -> list[str]:
    """Tools of the 3D view in Object Mode."""
    panel = ToolSelectPanelHelper._tool_class_from_space_type("VIEW_3D")
    listed = ToolSelectPanelHelper._tools_flatten(panel._tools["OBJECT"])
    return [tool.idname for tool in listed if tool is not None]


def test_the_tool_stands_behind_those_of_blender() -> None:
    """Once."""
    assert tools()[-1] == PaintTool.bl_idname and tools().count(PaintTool.bl_idname) == 1


def test_keys_of_the_tool_call_what_there_is() -> None:
    """Operators have the given properties, and data paths lead to the brush."""
    for name, _, given in PaintTool.bl_keymap:
        room, verb = name.split(".")
        known = getattr(getattr(bpy.ops, room), verb).get_rna_type().properties
        for key, value in given["properties"]:
            assert key in known, (name, key)
            if key.startswith("data_path"):
                assert (
                    bpy.context.path_resolve(value)
                    == bpy.context.window_manager.gscore_paint.radius
                )


def test_its_settings_are_those_of_the_brush() -> None:
    """Those of the session, as in the panel."""
    layout = Layout()
    PaintTool.draw_settings(bpy.context, layout, SimpleNamespace())
    assert "<radius>" in layout.notes and "<only_selected>" in layout.notes
