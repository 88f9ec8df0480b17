"""Chunk layout: splats divided by recursive halving of space into chunks of equal counts."""

import numpy as np

from ..io.lod_index import CHILDREN

MOST_IN_A_CHUNK = 8192
"""Splats of a chunk of the finest level: small enough to follow the picture's edge, large enough to
be read in one go."""


def levels_above(count: int) -> int:
    """How many coarser levels there are above the finest one of so many splats."""
    found = 0
    while count > MOST_IN_A_CHUNK * CHILDREN**found:
        found += 1
    return found


def chunks_of(means: np.ndarray, levels: int) -> np.ndarray:
    """[N] int32, the chunk of each place [N, 3] float32: one of 4^levels, which differ by one or so
    in how many they have.

    A part is halved across its longest side, at its median, until there are enough. So boxes stay
    compact wherever splats are dense, and a splat far away widens one chunk alone.
    """
    found = np.zeros(len(means), np.int32)
    parts = [np.arange(len(means), dtype=np.int64)]
    for _ in range(2 * levels):
        parts = [half for part in parts for half in _halves(means, part)]
    for chunk, part in enumerate(parts):
        found[part] = chunk
    return found


def _halves(means: np.ndarray, part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The rows of a part in two; sorted within each, so that the result does not depend on how the
    median was found."""
    places = means[part]
    axis = int(np.ptp(places.astype(np.float64), axis=0).argmax()) if len(part) else 0
    middle = len(part) // 2
    order = np.argpartition(places[:, axis], middle) if middle else np.arange(len(part))
    low, high = part[order[:middle]], part[order[middle:]]
    low.sort()
    high.sort()
    return low, high
