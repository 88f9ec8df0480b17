"""Histograms of the splats' opacities and sizes as icons that a panel can show."""

import bpy
import bpy.utils.previews
import numpy as np
from bpy.app.handlers import persistent

from .. import attributes
from ..splats.histogram import Histogram, of_opacities, of_sizes

OPACITY, SIZE = "opacity", "size"
_MOST = 200_000
"""Splats that are counted; of more, every so many-th, so that drawing a panel takes no time."""
_WIDTH = 192
_HEIGHT = 192


class HistogramIcons:
    """Two icons, of the object that was shown last; meshes are counted when they have changed."""

    def __init__(self) -> None:
        self._icons: bpy.utils.previews.ImagePreviewCollection | None = None
        self._counted: dict[int, dict[str, Histogram]] = {}
        """By the session number of the mesh."""
        self._drawn: dict[str, tuple[object, ...]] = {}
        """What each icon shows."""

    def open(self) -> None:
        """Make room for icons, and follow changes of meshes."""
        self._icons = bpy.utils.previews.new()
        bpy.app.handlers.depsgraph_update_post.append(_changed)

    def close(self) -> None:
        """Give it back."""
        bpy.app.handlers.depsgraph_update_post.remove(_changed)
        if self._icons is not None:
            bpy.utils.previews.remove(self._icons)
        self._icons = None
        self._counted.clear()
        self._drawn.clear()

    def forget(self, uids: set[int]) -> None:
        """Count these meshes anew when they are shown next."""
        for uid in uids:
            self._counted.pop(uid, None)

    def histograms(self, ob: bpy.types.Object) -> dict[str, Histogram]:
        """Of an object's own mesh; in Edit Mode, where it is out of reach, as it was before."""
        uid = ob.data.session_uid
        if uid not in self._counted:
            if ob.mode == "EDIT" or not len(ob.data.vertices):
                return {}
            self._counted.clear()  # one object is shown at a time
            every = slice(None, None, -(-len(ob.data.vertices) // _MOST))
            scales = attributes.column(ob.data, attributes.SCALE)[every]
            opacities = attributes.column(ob.data, attributes.BASE)[every, 3]
            self._counted[uid] = {
                OPACITY: of_opacities(opacities),
                SIZE: of_sizes(scales.max(axis=1)),
            }
        return self._counted[uid]

    def update(self, ob: bpy.types.Object, kind: str) -> int:
        """The icon of a histogram, with what the filters hide in grey; 0 where there is none.

        Raises:
            ValueError: attributes are missing.
        """
        found = self.histograms(ob).get(kind) if self._icons is not None else None
        if found is None:
            return 0
        own = ob.gscore
        limits = (own.opacity_min, 0.0) if kind == OPACITY else (own.size_min, own.size_max)
        icon = self._icons.get(kind) or self._icons.new(kind)
        if self._drawn.get(kind) != (found, *limits):
            self._drawn[kind] = found, *limits
            pixels = found.picture(_WIDTH, _HEIGHT, *limits)
            icon.image_size = (_WIDTH, _HEIGHT)
            icon.image_pixels_float.foreach_set(np.ascontiguousarray(pixels).ravel())
        return icon.icon_id


ICONS = HistogramIcons()
on_register, on_unregister = ICONS.open, ICONS.close


@persistent
def _changed(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    """Meshes were changed, by whomever."""
    meshes = {
        u.id.original.session_uid for u in depsgraph.updates if isinstance(u.id, bpy.types.Mesh)
    }
    if meshes:
        ICONS.forget(meshes)
