"""Reference feature matching, from all distances by definition; slow."""

import numpy as np


def match_descriptors(
    first: np.ndarray, second: np.ndarray, *, max_distance: float, max_ratio: float
) -> np.ndarray:
    """Like `gscore.raster.match.match_descriptors`."""
    difference = first[:, None].astype(np.float64) - second[None].astype(np.float64)
    squared = (difference**2).sum(axis=2)
    there = _distinct(squared, max_distance, max_ratio)
    back = _distinct(squared.T, max_distance, max_ratio)
    pairs = [(i, j) for i, j in enumerate(there) if j >= 0 and back[j] == i]
    return np.array(pairs, np.int32).reshape(-1, 2)


def _distinct(squared: np.ndarray, max_distance: float, max_ratio: float) -> list[int]:
    """The nearest neighbour of each row if it is near and distinct, else -1."""
    found = []
    for row in squared:
        order = np.argsort(row)
        near = len(row) > 0 and row[order[0]] <= max_distance**2
        distinct = len(row) < 2 or row[order[0]] < max_ratio**2 * row[order[1]]
        found.append(int(order[0]) if near and distinct else -1)
    return found
