"""Icons for panels, drawn by the add-on."""

from collections.abc import Callable

import bpy
import bpy.utils.previews
import numpy as np


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
