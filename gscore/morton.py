"""Morton order of points, and their distances from their middle."""

import numpy as np

_BITS = 21


def morton_order(means: np.ndarray) -> np.ndarray:
    """[N] indices along the Z-order curve through positions [N, 3] (Morton 1966).

    The grid spans the 0.1 % to 99.9 % quantiles, so that a few far splats do not make it coarse;
    positions outside are clamped to it.
    """
    if not len(means):
        return np.zeros(0, np.intp)
    low, high = np.quantile(means[:: max(1, len(means) // 100_000)], (0.001, 0.999), axis=0)
    top = (1 << _BITS) - 1
    steps = (means.astype(np.float64) - low) / np.maximum(high - low, 1e-30)
    return cell_order((np.clip(steps, 0, 1) * top).astype(np.uint64))


def cell_order(cells: np.ndarray) -> np.ndarray:
    """[N] indices along the Z-order curve through cells [N, 3] uint64, below 2^21 each; rows in one
    cell keep their order."""
    x, y, z = (_spread(cells[:, axis]) for axis in range(3))
    return np.argsort(x | y << np.uint64(1) | z << np.uint64(2), kind="stable")


def _spread(values: np.ndarray) -> np.ndarray:
    """The 21 bits of each number, separated by two zeros."""
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        values = (values | values << np.uint64(shift)) & np.uint64(mask)
    return values


def middle_of(means: np.ndarray) -> np.ndarray:
    """[3] float64, median of positions [N, 3] along each axis; N >= 1."""
    return np.percentile(means.astype(np.float64), 50, axis=0, method="lower")


def distances_from_middle(means: np.ndarray) -> tuple[np.ndarray, float]:
    """Chebyshev distances [N] float64 of positions [N, 3] from their median, and the median of
    these distances, above zero."""
    if not len(means):
        return np.zeros(0), _LEAST
    away = np.abs(means.astype(np.float64) - middle_of(means)).max(axis=1)
    return away, max(float(np.percentile(away, 50, method="lower")), _LEAST)


_LEAST = 1e-30
"""World units, for positions that are all equal."""
