"""Curve icon: the loss curve of a training as an icon in a panel, and its line colours."""

import numpy as np

from ..interface.images import PictureIcons
from ..training.curve import LOSS_COLOR, PSNR_COLOR
from ..training.training_job import Job

_SIZE = 192
_SWATCH = 32
LOSS, PSNR = "loss", "PSNR"
_COLORS = {LOSS: LOSS_COLOR, PSNR: PSNR_COLOR}


class CurveIcons(PictureIcons):
    """Icons: one for each training, and one for each color."""

    def update(self, job: Job) -> int:
        """The icon of a job's curve, drawn again if it has more points; 0 without a window."""
        curve = job.state.curve
        last = curve.steps[-1] if curve.steps else 0
        last_step = job.state.iterations
        return self.show(job.id, last, lambda: curve.picture(_SIZE, _SIZE, last_step=last_step))

    def swatch(self, line: str) -> int:
        """An icon in the color of a line, LOSS or PSNR; 0 without a window."""
        return self.show(line, line, lambda: _swatch(_COLORS[line]))


def _swatch(color: tuple[float, ...]) -> np.ndarray:
    pixels = np.zeros((_SWATCH, _SWATCH, 4), np.float32)
    pixels[_SWATCH // 2 - 3 : _SWATCH // 2 + 3] = (*color, 1)
    return pixels


ICONS = CurveIcons()
on_register, on_unregister = ICONS.open, ICONS.close
