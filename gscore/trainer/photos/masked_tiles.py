"""Masked tiles: tiles of a view that need not be drawn."""

import numpy as np

from ...raster import native_library


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
