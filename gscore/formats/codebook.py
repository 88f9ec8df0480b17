"""Codebooks: 256 numbers for many values, palettes of up to 65,536 rows of SH coefficients."""

import numpy as np

CODEBOOK_SIZE = 256
"""Numbers of a codebook."""
MOST_ROWS = 1 << 16
"""Of a palette."""
_BINS, _BINS_A_GUESS = 1 << 14, 1 << 5
_ROUNDS = 20
_LOOKED_AT = 200_000
_FEW = 1024
_MOST_ERROR = 0.02
"""Root mean square of what SH coefficients may lose to a short palette where a whole one fits."""


def codebook(values: np.ndarray) -> np.ndarray:
    """[256] float32 ascending: numbers near which all `values` lie (Lloyd 1982, Max 1960).

    The first guess is that for fine steps, a density of numbers that is the cube root of that of
    the values; the rounds run on a histogram.
    """
    values = values.ravel()
    low, high = (float(values.min()), float(values.max())) if len(values) else (0.0, 0.0)
    if not high > low:
        return np.full(CODEBOOK_SIZE, low, np.float32)
    counts, edges = np.histogram(values, _BINS, (low, high))
    middles = (edges[:-1] + edges[1:]) / 2
    amount = np.concatenate([[0.0], np.cumsum(counts)])
    moment = np.concatenate([[0.0], np.cumsum(counts * middles)])
    # Over wider bins: in fine ones the tails hold one value or none, whose cube roots say little.
    density = counts.reshape(-1, _BINS_A_GUESS).sum(axis=1)
    share = np.cumsum(np.repeat(np.cbrt(density), _BINS_A_GUESS) + 1e-9)
    at = np.searchsorted(share, (np.arange(CODEBOOK_SIZE) + 0.5) / CODEBOOK_SIZE * share[-1])
    found = middles[np.minimum(at, _BINS - 1)]
    for _ in range(_ROUNDS):
        borders = np.searchsorted(middles, (found[1:] + found[:-1]) / 2)
        borders = np.concatenate([[0], borders, [_BINS]])
        held = np.diff(amount[borders])
        means = np.diff(moment[borders]) / np.maximum(held, 1)
        found = np.where(held > 0, means, found)
    return np.sort(found).astype(np.float32)


def nearest_entries(book: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Indices as uint8 into an ascending codebook, of the shape of `values`."""
    return np.searchsorted((book[1:] + book[:-1]) / 2, values).astype(np.uint8)


def palette(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Few rows near which all rows lie, and which of them each one is: a half to a quarter of them,
    65,536 at most; all of them where there are 1,024 or fewer, or where fewer would lose much.

    They are halved again and again at the median of a principal component, so that
    groups are of one size; each gets the mean of its rows. Which component a halving takes is
    settled beforehand for all groups: the one with the largest variance left.

    Args:
        rows: [N, D] float32.

    Returns:
        The palette [P, D] float32 and labels [N] uint16.
    """
    count = len(rows)
    if count <= _FEW:
        return rows, np.arange(count, dtype=np.uint16)
    groups = min(MOST_ROWS, 1 << ((count // 2).bit_length() - 1))
    order = np.arange(count)
    each = -(-count // groups)
    # Groups of one size make each halving one call; the last rows are repeated to fill them.
    order = np.concatenate([order, order[: each * groups - count]])
    axes, plan = _halvings(rows, groups)
    for level, component in enumerate(plan):
        values = rows @ axes[:, component]
        grouped = order.reshape(1 << level, -1)
        half = grouped.shape[1] // 2
        split = np.argpartition(values[grouped], half, axis=1)
        order = np.take_along_axis(grouped, split, axis=1).ravel()
    found, labels = _means(rows, order.reshape(groups, each), count)
    error = float(np.sqrt(np.mean((found[labels] - rows) ** 2, dtype=np.float64)))
    if error > _MOST_ERROR and count <= MOST_ROWS:
        return rows, np.arange(count, dtype=np.uint16)
    return found, labels


def _halvings(rows: np.ndarray, groups: int) -> tuple[np.ndarray, list[int]]:
    """Principal axes [D, D] as columns, and which one each halving takes."""
    some = rows[:: max(1, len(rows) // _LOOKED_AT)].astype(np.float64)
    variances, axes = np.linalg.eigh(np.cov(some, rowvar=False))
    left, plan = variances.copy(), []
    for _ in range(groups.bit_length() - 1):
        plan.append(int(left.argmax()))
        left[plan[-1]] /= 4
    return axes.astype(np.float32), plan


def _means(rows: np.ndarray, members: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Means of the groups [P, K] of rows, and the group of each row."""
    found = np.empty((len(members), rows.shape[1]), np.float32)
    for column in range(rows.shape[1]):
        found[:, column] = rows[:, column][members].mean(axis=1)
    labels = np.empty(count, np.uint16)
    labels[members.ravel()] = np.repeat(np.arange(len(members), dtype=np.uint16), members.shape[1])
    return found, labels
