"""Blocks of splats that share a quantisation box: neighbours along a curve, without outliers."""

import numpy as np

from ..morton import distances_from_middle, morton_order

BLOCK = 256
"""Maximum number of splats of a block."""
_WIDEST = 4.0
"""Maximum side of a box, relative to a distance from the middle of all splats: that of the nearest
splat of the block, or the median of all splats if larger."""


def blocks_of(means: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """An order [N] of positions [N, 3], and the lengths of its blocks [B], 1 to 256, with sum N.

    Each is an interval of 256 along a Morton curve, split at its widest gaps if its box would be so
    large that quantised positions become coarse. A single far splat does not affect its neighbours.
    """
    order = morton_order(means)
    away, usual = distances_from_middle(means)
    starts = np.arange(0, len(means), BLOCK)
    if not len(starts):
        return order, starts
    sorted_means = means[order].astype(np.float64)
    low = np.minimum.reduceat(sorted_means, starts)
    side = (np.maximum.reduceat(sorted_means, starts) - low).max(axis=1)
    nearest = np.minimum.reduceat(away[order], starts)
    loose = side > _WIDEST * np.maximum(nearest, usual)
    lengths: list[int] = []
    for start, cut in zip(starts.tolist(), loose.tolist(), strict=True):
        rows = order[start : start + BLOCK]
        parts = _tight(rows, means, away, usual) if cut else [rows]
        order[start : start + BLOCK] = np.concatenate(parts)
        lengths += map(len, parts)
    return order, np.array(lengths)


def _tight(rows: np.ndarray, means: np.ndarray, away: np.ndarray, usual: float) -> list[np.ndarray]:
    """The rows split into parts with small boxes, in the order of the curve within each."""
    left, found = [rows], []
    while left:
        part = left.pop()
        places = means[part].astype(np.float64)
        sides = np.ptp(places, axis=0)
        if sides.max() <= _WIDEST * max(away[part].min(), usual):
            found.append(part)
            continue
        along = places[:, sides.argmax()]
        steps = np.sort(along)
        first_beyond = steps[np.diff(steps).argmax() + 1]
        left += [part[along >= first_beyond], part[along < first_beyond]]
    return found
