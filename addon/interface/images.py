"""Pictures in image editors."""

import bpy


def show_image(
    context: bpy.types.Context, image: bpy.types.Image, *, new_window: bool = False
) -> bool:
    """Show an image in an image editor, if one is open or a window may be opened for it."""
    return editor_of(context, image, new_window=new_window) is not None


def editor_of(
    context: bpy.types.Context, image: bpy.types.Image, *, new_window: bool = False
) -> bpy.types.Area | None:
    """The area of the image editor that `show_image` shows an image in."""
    windows = context.window_manager.windows
    areas = (area for window in windows for area in window.screen.areas)
    area = next((a for a in areas if a.type == "IMAGE_EDITOR"), None)
    if area is None and new_window and not bpy.app.background:
        bpy.ops.wm.window_new()
        area = context.window_manager.windows[-1].screen.areas[0]
        area.type = "IMAGE_EDITOR"
    if area is None:
        return None
    area.spaces.active.image = image
    return area
