"""Images in image editors, and pictures as icons of panels."""

from collections.abc import Callable

import bpy
import bpy.utils.previews
import numpy as np

from .windows import in_a_window

_FILLS = 0.9
"""Share of an editor's width and height; its header and scrollbars cover the rest."""


def show_image(
    context: bpy.types.Context, image: bpy.types.Image, *, new_window: bool = False
) -> bool:
    """Show an image in an image editor, if one is open or a window may be opened for it."""
    return editor_of(context, image, new_window=new_window) is not None


def show_soon(context: bpy.types.Context, image: bpy.types.Image) -> bool:
    """Like `show_image`, in a new window if needed; True if the image is or will be shown.

    For modal operators: Blender misses the end of one that has opened a window, so a timer opens
    it right after.
    """
    if show_image(context, image):
        return True
    if bpy.app.background:
        return False
    name = image.name

    def show() -> None:
        current = bpy.data.images.get(name)
        with in_a_window() as there_is_a_window:
            if current is not None and there_is_a_window:
                show_image(bpy.context, current, new_window=True)

    bpy.app.timers.register(show, first_interval=0.0)
    return True


def editor_of(
    context: bpy.types.Context, image: bpy.types.Image, *, new_window: bool = False
) -> bpy.types.Area | None:
    """The image editor area of `show_image`, zoomed to the whole image."""
    windows = context.window_manager.windows
    areas = (area for window in windows for area in window.screen.areas)
    area = next((a for a in areas if a.type == "IMAGE_EDITOR"), None)
    if area is None and new_window and not bpy.app.background:
        bpy.ops.wm.window_new()
        area = context.window_manager.windows[-1].screen.areas[0]
        area.type = "IMAGE_EDITOR"
    if area is None:
        return None
    if area.spaces.active.image != image:  # else the user's zoom is kept
        area.spaces.active.image = image
        fit(area)
    return area


def fit(area: bpy.types.Area) -> bool:
    """Zoom out until the image of an editor fits next to its sidebar; True.

    `bpy.ops.image.view_all` would need another context, and an area that has been drawn.
    """
    space, size = area.spaces.active, (area.width, area.height)
    if area.width <= 1:  # an area in a new window has no size yet
        windows = bpy.context.window_manager.windows
        window = next(window for window in windows if area in window.screen.areas[:])
        size = (window.width, window.height)
    over = bpy.context.preferences.system.use_region_overlap and space.show_region_ui
    sidebar = max((r.width for r in area.regions if r.type == "UI" and over), default=0)
    # The image stays centred, so the sidebar takes its width on both sides.
    free = max(size[0] - 2 * sidebar, size[0] // 2)
    zoom = min(
        _FILLS * free / max(space.image.size[0], 1),
        _FILLS * size[1] / max(space.image.size[1], 1),
    )
    space.zoom_percentage = 100 * min(zoom, 1.0)
    return True


class PictureIcons:
    """Icons by name, cached in a preview collection."""

    def __init__(self) -> None:
        self._icons: bpy.utils.previews.ImagePreviewCollection | None = None
        self._shown: dict[str, object] = {}
        """Content key by icon."""

    def open(self) -> None:
        """Create the preview collection."""
        self._icons = bpy.utils.previews.new()

    def close(self) -> None:
        """Remove the preview collection."""
        if self._icons is not None:
            bpy.utils.previews.remove(self._icons)
        self._icons = None
        self._shown.clear()

    def show(self, name: str, what: object, picture: Callable[[], np.ndarray]) -> int:
        """Icon id, drawn again if its content changed; 0 without a collection.

        Args:
            name: Icon name.
            what: Content key, different for different pictures.
            picture: Draws it: [H, W, 4] float32 RGBA, premultiplied, bottom row first.
        """
        if self._icons is None:
            return 0
        icon = self._icons.get(name) or self._icons.new(name)
        if name not in self._shown or self._shown[name] != what:
            self._shown[name] = what
            pixels = picture()
            icon.image_size = pixels.shape[1::-1]
            icon.image_pixels_float.foreach_set(pixels.ravel())
        return icon.icon_id
