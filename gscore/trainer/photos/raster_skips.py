"""Rasterizer skips: skips of the training that the rasterizer implements, and masked tiles."""

from collections.abc import Collection

import numpy as np

from ...config import Skip
from ...raster import native_library

_RASTER = {
    Skip.EXACT_CULL: native_library.NO_EXACT_CULL,
    Skip.OPACITY_EXTENT: native_library.NO_OPACITY_EXTENT,
    Skip.ROW_RANGE: native_library.NO_ROW_RANGE,
    Skip.ZERO_TILE: native_library.NO_ZERO_TILE,
}


def disabled_skips(without: Collection[Skip]) -> int:
    """Return the flags `disable` of `rasterize` for the disabled skips."""
    return sum(bit for skip, bit in _RASTER.items() if skip in without)


def tiles_of_mask(mask: np.ndarray) -> np.ndarray:
    """Return [ceil(H / 16), ceil(W / 16)] uint8, 1 for tiles with a non-zero pixel of `mask`, which
    is [H, W] uint8."""
    tile = native_library.TILE
    height, width = mask.shape
    rows, columns = -(-height // tile), -(-width // tile)
    padded = np.zeros((rows * tile, columns * tile), bool)
    padded[:height, :width] = mask > 0
    blocks = padded.reshape(rows, tile, columns, tile)
    return np.asarray(blocks.any(axis=(1, 3)), np.uint8)
