"""Chunk layout: splats divided by recursive halving of space into chunks of equal counts."""

import numpy as np

from ..io.lod_index import CHILDREN

MOST_IN_A_CHUNK = 8192
"""Most splats of a chunk of the finest level: small enough for culling at the picture's edge, large
enough for efficient reading."""


def levels_above(count: int) -> int:
    """Number of coarser levels above a finest level of `count` splats."""
    levels = 0
    while count > MOST_IN_A_CHUNK * CHILDREN**levels:
        levels += 1
    return levels


def chunks_of(means: np.ndarray, levels: int) -> np.ndarray:
    """[N] int32, the chunk of each of the means [N, 3] float32: one of 4^levels chunks, whose
    counts differ by about one.

    Each part is halved across its longest side, at its median, so boxes stay compact where splats
    are dense, and a far splat widens only one chunk.
    """
    found = np.zeros(len(means), np.int32)
    parts = [np.arange(len(means), dtype=np.int64)]
    for _ in range(2 * levels):
        parts = [half for part in parts for half in _halves(means, part)]
    for chunk, part in enumerate(parts):
        found[part] = chunk
    return found


def _halves(means: np.ndarray, part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Halves of the rows of a part, each sorted, so that the result does not depend on the search
    of the median."""
    points = means[part]
    axis = int(np.ptp(points.astype(np.float64), axis=0).argmax()) if len(part) else 0
    middle = len(part) // 2
    order = np.argpartition(points[:, axis], middle) if middle else np.arange(len(part))
    low, high = part[order[:middle]], part[order[middle:]]
    low.sort()
    high.sort()
    return low, high
