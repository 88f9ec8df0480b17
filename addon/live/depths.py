"""Depth buffer of a view: depths of Blender's own objects, which hide splats, and its lines
drawn over everything, detected in the picture; for draw handlers.
"""

import gpu
import numpy as np

from .texture_upload import texture


class Depths:
    """Depths of one view. The texture stays the same object until the depths change, so that
    pictures drawn with it stay valid."""

    def __init__(self) -> None:
        self._size = (0, 0)
        self._read: list[np.ndarray] = []
        self._texture: gpu.types.GPUTexture | None = None

    def read(
        self, left: int, bottom: int, width: int, height: int, *, front: bool = False
    ) -> gpu.types.GPUTexture:
        """Depths of a part of the current target in [0, 1], the bottom row first; waits until the
        card has drawn it.

        Args:
            left: Pixels.
            bottom: Pixels.
            width: Pixels.
            height: Pixels.
            front: Whether lines without a depth get depth 0, the near end.
        """
        part = left, bottom, width, height
        found = [_read_depths(*part), *([_read_alphas(*part)] if front else [])]
        size, pairs = (width, height), zip(found, self._read, strict=False)
        same = self._size == size and len(found) == len(self._read)
        if self._texture is None or not (same and all(np.array_equal(*pair) for pair in pairs)):
            shown = found[0].view(np.float32).reshape(height, width)
            if front:
                shown = np.where(in_front(shown, found[1].reshape(height, width)), 0, shown)
            self._texture = texture(shown.astype(np.float32, copy=False)[..., None])
            self._size, self._read = (width, height), found
        return self._texture


def _read_depths(left: int, bottom: int, width: int, height: int) -> np.ndarray:
    """Depths as bits of float32, [width * height] uint32, for a fast and exact comparison."""
    found = gpu.state.active_framebuffer_get().read_depth(left, bottom, width, height)
    found.dimensions = width * height
    return np.asarray(found, np.float32).view(np.uint32)  # shares memory


def _read_alphas(left: int, bottom: int, width: int, height: int) -> np.ndarray:
    """Opacities of overlays, which a view stores separately, [width * height] uint8."""
    target = gpu.state.active_framebuffer_get()
    found = target.read_color(left, bottom, width, height, 4, 0, "UBYTE")
    found.dimensions = width * height * 4
    return np.asarray(found, np.uint8)[3::4].copy()


_OPAQUE = 128
"""Overlay opacity, of 255, from which a pixel counts as covered."""
_AROUND = 2
"""Radius of the neighborhood from which a line's own depth differs, px."""
_NEARER = 1.05
"""Least factor by which a line with a depth of its own is nearer than its neighborhood."""


def in_front(depths: np.ndarray, alphas: np.ndarray) -> np.ndarray:
    """Pixels of overlays without a depth.

    Blender stores the depths of lines *In Front* where no add-on can read them, but draws their
    colours together with those of all overlays.

    Args:
        depths: [H, W] float32 in [0, 1], of meshes and of all other overlays.
        alphas: [H, W] uint8, opacities of overlays.

    Returns:
        [H, W] bool, including outlines of selected objects, which have no depth either.
    """
    covered = alphas >= _OPAQUE
    if not covered.any():
        return covered
    behind = depths
    for axis in (0, 1):
        behind = _highest(behind, axis, _AROUND)
    placed = (alphas > 0) & ((1 - depths) > _NEARER * (1 - behind))
    for axis in (0, 1):
        placed = _highest(placed, axis, 1)  # soft edges, which have no depth
    return covered & ~placed


def _highest(values: np.ndarray, axis: int, around: int) -> np.ndarray:
    """Maximum filter along an axis."""
    lines = np.moveaxis(values, axis, 0)
    out = lines.copy()
    for k in range(1, around + 1):
        np.maximum(out[k:], lines[:-k], out=out[k:])
        np.maximum(out[:-k], lines[k:], out=out[:-k])
    return np.moveaxis(out, 0, axis)
