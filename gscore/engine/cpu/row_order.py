"""Row order: Morton order of splats, so that neighbours are close in memory."""

import numpy as np
import torch

from ...raster.memory import zeros


def morton_order(means: torch.Tensor) -> torch.Tensor:
    """Return rows, [M] int64, in Morton order of `means`, [M, 3], so that neighbouring splats are
    close in memory; splats in one cell keep their order.

    The grid has 1024 cells per side over the middle 98 % of each axis; splats beyond are clamped
    to the outermost cells.
    """
    points = np.nan_to_num(means.numpy().astype(np.float64))
    if len(points) == 0:
        return zeros(0, dtype=torch.int64)
    low, high = np.percentile(points[:: max(1, len(points) // 4096)], (1, 99), axis=0)
    cells = (points - low) / np.maximum(high - low, 1e-30) * (_CELLS - 1)
    cells = np.clip(cells, 0, _CELLS - 1).astype(np.uint32)
    x, y, z = (_spread(cells[:, axis]) for axis in range(3))
    return torch.from_numpy(np.argsort(x | y << 1 | z << 2, kind="stable"))


_CELLS = 1024


def _spread(x: np.ndarray) -> np.ndarray:
    """Insert two zero bits after each bit of numbers below 1024."""
    for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        x = (x | x << shift) & mask
    return x
