"""Depths of what Blender has drawn in a view, which hides splats; used where Blender draws."""

import gpu
import numpy as np

from .uploads import texture


class Depths:
    """Of one view. As long as they stay the same, so does their texture: who has drawn with it need
    not draw again."""

    def __init__(self) -> None:
        self._values = np.empty(0, np.uint32)
        self._texture: gpu.types.GPUTexture | None = None

    def read(self, left: int, bottom: int, width: int, height: int) -> gpu.types.GPUTexture:
        """Those of a part of what is drawn to, in [0, 1]; waits until the card has drawn it."""
        values = _read(left, bottom, width, height)
        known = self._texture
        size = None if known is None else (known.width, known.height)
        if size != (width, height) or not np.array_equal(values, self._values):
            self._texture = texture(values.view(np.float32).reshape(height, width, 1))
            self._values = values
        return self._texture


def _read(left: int, bottom: int, width: int, height: int) -> np.ndarray:
    """[width * height] uint32, the bits of float32: they are compared fast, and exactly."""
    found = gpu.state.active_framebuffer_get().read_depth(left, bottom, width, height)
    found.dimensions = width * height
    return np.asarray(found, np.float32).view(np.uint32)  # of the same memory
