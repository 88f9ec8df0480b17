"""Error colors: cameras of a capture coloured by the PSNR of their photos."""

import bpy
import numpy as np

from ..cameras.camera_colors import marks, own_cameras, set_color, take
from ..capture.figures import Figures
from ..core import colorize

_MARK = "error"
_DARKEST = 0.15
"""Position of the best photo in the color map, above 0 because black lines are hard to see."""


def show(root: bpy.types.Object, figures: Figures) -> int:
    """Color the cameras of a capture by the PSNR of their photos; return their number."""
    ranked, known = figures.ranked, figures.views
    low, high = (ranked[0][1], ranked[-1][1]) if ranked else (0.0, 0.0)
    shown = 0
    for ob in own_cameras(root):
        name = str(ob.get("gs_image", ""))
        if name not in known:
            take(ob)
            continue
        psnr = known[name]
        place = 0.0 if psnr is None or high <= low else (high - psnr) / (high - low)
        set_color(ob, _MARK, color_at(place))
        shown += 1
    return shown


def color_at(place: float) -> tuple[float, ...]:
    """Linear RGBA from the best, 0, to the worst, 1."""
    srgb = colorize(np.array(_DARKEST + (1 - _DARKEST) * place)) / 255.0
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    return (*linear.tolist(), 1.0)


def shown(root: bpy.types.Object) -> bool:
    """Whether cameras of a capture are colored by errors."""
    return _MARK in marks(root)
