"""Depth buffer of a view: depths of Blender's own objects, which hide splats; for draw handlers."""

import gpu
import numpy as np

from .overlay_lines import in_front
from .uploads import texture


class Depths:
    """Of one view. As long as they stay the same, so do their array and texture: who has drawn with
    those need not draw again."""

    def __init__(self) -> None:
        self._size = (0, 0)
        self._read: list[np.ndarray] = []
        self._values: np.ndarray | None = None
        self._texture: gpu.types.GPUTexture | None = None

    def read(
        self, left: int, bottom: int, width: int, height: int, *, front: bool = False
    ) -> gpu.types.GPUTexture:
        """As `values`, on the card."""
        shown = self.values(left, bottom, width, height, front=front)
        if self._texture is None:
            self._texture = texture(shown[..., None])
        return self._texture

    def values(
        self, left: int, bottom: int, width: int, height: int, *, front: bool = False
    ) -> np.ndarray:
        """[H, W] float32 in [0, 1] of a part of what is drawn to, the bottom row first; waits until
        the card has drawn it.

        Args:
            left: Pixels.
            bottom: Pixels.
            width: Pixels.
            height: Pixels.
            front: Whether lines without a depth get that of the view's near end.
        """
        part = left, bottom, width, height
        found = [_read_depths(*part), *([_read_alphas(*part)] if front else [])]
        if self._values is None or not self._same((width, height), found):
            shown = found[0].view(np.float32).reshape(height, width)
            if front:
                shown = np.where(in_front(shown, found[1].reshape(height, width)), 0, shown)
            self._values, self._texture = shown.astype(np.float32, copy=False), None
            self._size, self._read = (width, height), found
        return self._values

    def _same(self, size: tuple[int, int], found: list[np.ndarray]) -> bool:
        """Whether that was read before."""
        return (
            self._size == size
            and len(found) == len(self._read)
            and all(map(np.array_equal, found, self._read))
        )


def _read_depths(left: int, bottom: int, width: int, height: int) -> np.ndarray:
    """[width * height] uint32, the bits of float32: they are compared fast, and exactly."""
    found = gpu.state.active_framebuffer_get().read_depth(left, bottom, width, height)
    found.dimensions = width * height
    return np.asarray(found, np.float32).view(np.uint32)  # of the same memory


def _read_alphas(left: int, bottom: int, width: int, height: int) -> np.ndarray:
    """[width * height] uint8: opacities of overlays, which a view keeps apart."""
    target = gpu.state.active_framebuffer_get()
    found = target.read_color(left, bottom, width, height, 4, 0, "UBYTE")
    found.dimensions = width * height * 4
    return np.asarray(found, np.uint8)[3::4].copy()
