"""The curve of a training as an icon that a panel can show, and the colors of its lines."""

import bpy
import bpy.utils.previews
import numpy as np

from ..job.curve import LOSS_COLOR, PSNR_COLOR
from ..job.job import Job

_SIZE = 192
_SWATCH = 32
LOSS, PSNR = "loss", "PSNR"
_COLORS = {LOSS: LOSS_COLOR, PSNR: PSNR_COLOR}


class CurveIcons:
    """An icon for each training, kept while Blender has room for icons."""

    def __init__(self) -> None:
        self._icons: bpy.utils.previews.ImagePreviewCollection | None = None
        self._drawn: dict[str, int] = {}
        """Last step that each job's icon shows."""

    def open(self) -> None:
        """Make room for icons."""
        self._icons = bpy.utils.previews.new()

    def close(self) -> None:
        """Give it back."""
        if self._icons is not None:
            bpy.utils.previews.remove(self._icons)
        self._icons = None
        self._drawn.clear()

    def update(self, job: Job) -> int:
        """The icon of a job's curve, drawn anew if there are more points; 0 without a window."""
        if self._icons is None:
            return 0
        icon = self._icons.get(job.id) or self._icons.new(job.id)
        curve = job.state.curve
        last = curve.steps[-1] if curve.steps else 0
        if self._drawn.get(job.id) != last:
            self._drawn[job.id] = last
            _fill(icon, curve.picture(_SIZE, _SIZE, last_step=job.state.iterations))
        return icon.icon_id

    def swatch(self, line: str) -> int:
        """An icon of the color of a line, LOSS or PSNR; 0 without a window."""
        if self._icons is None:
            return 0
        if line not in self._icons:
            pixels = np.zeros((_SWATCH, _SWATCH, 4), np.float32)
            middle = slice(_SWATCH // 2 - 3, _SWATCH // 2 + 3)
            pixels[middle] = (*_COLORS[line], 1)
            _fill(self._icons.new(line), pixels)
        return self._icons[line].icon_id


def _fill(icon: bpy.types.ImagePreview, pixels: np.ndarray) -> None:
    icon.image_size = pixels.shape[1::-1]
    icon.image_pixels_float.foreach_set(pixels.ravel())


ICONS = CurveIcons()
on_register, on_unregister = ICONS.open, ICONS.close
