"""Pictures in image editors."""

import bpy


def show_image(
    context: bpy.types.Context, image: bpy.types.Image, *, new_window: bool = False
) -> bool:
    """Show an image in an image editor, if one is open or a window may be opened for it."""
    windows = context.window_manager.windows
    areas = (area for window in windows for area in window.screen.areas)
    area = next((a for a in areas if a.type == "IMAGE_EDITOR"), None)
    if area is None and new_window and not bpy.app.background:
        bpy.ops.wm.window_new()
        area = context.window_manager.windows[-1].screen.areas[0]
        area.type = "IMAGE_EDITOR"
    if area is None:
        return False
    area.spaces.active.image = image
    return True
