"""Histograms of the splats' opacities and sizes as icons that a panel can show."""

import bpy
import bpy.utils.previews
import numpy as np

from .counted import COUNTED
from .limits import limits_of

_WIDTH = 192
_HEIGHT = 192


class HistogramIcons:
    """One of each kind, of the object that was shown last."""

    def __init__(self) -> None:
        self._icons: bpy.utils.previews.ImagePreviewCollection | None = None
        self._drawn: dict[str, tuple[object, ...]] = {}
        """What each icon shows."""

    def open(self) -> None:
        """Make room for icons."""
        self._icons = bpy.utils.previews.new()

    def close(self) -> None:
        """Give it back."""
        if self._icons is not None:
            bpy.utils.previews.remove(self._icons)
        self._icons = None
        self._drawn.clear()

    def update(self, ob: bpy.types.Object, kind: str) -> int:
        """The icon of a histogram, with what the filters hide in grey; 0 where there is none."""
        found = COUNTED.of(ob).get(kind) if self._icons is not None else None
        if found is None:
            return 0
        limits = limits_of(ob, kind)
        icon = self._icons.get(kind) or self._icons.new(kind)
        if self._drawn.get(kind) != (found, *limits):
            self._drawn[kind] = found, *limits
            pixels = found.picture(_WIDTH, _HEIGHT, *limits)
            icon.image_size = (_WIDTH, _HEIGHT)
            icon.image_pixels_float.foreach_set(np.ascontiguousarray(pixels).ravel())
        return icon.icon_id


ICONS = HistogramIcons()
on_register, on_unregister = ICONS.open, ICONS.close
