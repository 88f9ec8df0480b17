"""Histogram icons of the opacities and sizes of splats, for panels."""

import bpy

from ..interface.images import PictureIcons
from .histogram_cache import HISTOGRAMS
from .limits import limits_of

_SIZE = 192


class HistogramIcons(PictureIcons):
    """One icon per kind, of the last shown object."""

    def update(self, ob: bpy.types.Object, kind: str) -> int:
        """Icon id of a histogram, hidden splats in grey; 0 if there is none."""
        if (found := HISTOGRAMS.of(ob).get(kind)) is None:
            return 0
        limits = limits_of(ob, kind)
        return self.show(kind, (found, *limits), lambda: found.picture(_SIZE, _SIZE, *limits))


ICONS = HistogramIcons()
on_register, on_unregister = ICONS.open, ICONS.close
