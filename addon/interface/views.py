"""The 3D views of all windows."""

import bpy


def redraw_views() -> None:
    """Redraw all 3D views."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()
