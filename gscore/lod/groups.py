"""Groups of splats that merge at a coarser level: neighbours whose merge changes the least."""

import numpy as np

from ..extras import need

_NEIGHBOURS = 6
"""Number of neighbours among which each splat's partner is chosen."""
_FEW = 30
"""Where less than one of so many finds a pair in a round, others need not wait for one."""
_A_ROUND = 8
"""Of these one of so many rows is joined at most: costs change as groups grow."""
_COLOR = 5.0
"""How far apart, in standard deviations of the larger one, two splats of one place count that
differ by 1 in all colours."""


def groups_of(
    means: np.ndarray, weights: np.ndarray, sizes: np.ndarray, colors: np.ndarray, wanted: int
) -> np.ndarray:
    """[N] int64, the group of each splat, from 0 to `wanted` - 1.

    Pairs whose joining changes least are joined first, as Ward (1963) does: two groups of weights a
    and b at a distance d cost a b / (a + b) times d^2 / (d^2 + s^2), where s is the size of the
    larger one. So specks go before what a picture shows large, and what overlaps before what lies
    beside each other. A round joins those that are each other's best, cheapest first.

    Args:
        means: [N, 3] float64.
        weights: [N] float64, above 0: what each covers.
        sizes: [N] float64, standard deviations, world units.
        colors: [N, 3] float64, from 0 to 1 or so.
        wanted: How many groups, 1 to N.

    Raises:
        BackendError: scipy is not installed.
    """
    group = np.arange(len(means))
    features = np.concatenate([means, colors, sizes[:, None] ** 2], axis=1)
    weights = weights / weights.max()
    while len(features) > wanted:
        joins, takes = _round(features, weights, len(features) - wanted)
        features, weights, step = _joined(features, weights, joins, takes)
        group = step[group]
    return group


def _round(features: np.ndarray, weights: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows [P] that are joined to others [P] in this round, P at least 1 and at most `most`.

    The heavier of two that are each other's best takes in the other. Where few are, because specks
    wait for each other around something large, every second row takes in all whose best it is.
    """
    count = len(features)
    means, near = features[:, :3], min(_NEIGHBOURS + 1, count)
    tree = need("scipy.spatial", "Making levels of detail").cKDTree(means)
    beside = tree.query(means, k=near)[1].reshape(count, near)
    rows = np.repeat(np.arange(count), near).reshape(count, near)
    costs = np.where(beside == rows, np.inf, _costs(features, weights, rows, beside))
    best = costs.argmin(axis=1)
    all_rows = np.arange(count)
    mine, partner = costs[all_rows, best], beside[all_rows, best]
    mutual = np.flatnonzero((partner[partner] == all_rows) & (partner > all_rows))
    if not len(mutual):  # rings of equal costs: the cheapest of all
        row = int(mine.argmin())
        return np.array([row]), partner[[row]]
    heavier = weights[mutual] >= weights[partner[mutual]]
    joins = np.where(heavier, partner[mutual], mutual)
    if len(joins) * _FEW < count:
        takes = all_rows % 2 == 0
        others = np.flatnonzero(takes[partner] & ~takes)
        joins, most = (others, min(most, -(-count // _A_ROUND))) if len(others) else (joins, most)
    joins = joins[np.argsort(mine[joins], kind="stable")[:most]]
    return joins, partner[joins]


def _costs(features: np.ndarray, weights: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    apart = features[a, :6] - features[b, :6]
    away = (apart[..., :3] ** 2).sum(axis=-1)
    own = np.maximum(features[a, 6], features[b, 6])
    away = away + _COLOR**2 * own * (apart[..., 3:] ** 2).mean(axis=-1)
    product = weights[a] * weights[b] / (weights[a] + weights[b])
    return product * away / np.maximum(away + own, 1e-300)


def _joined(
    features: np.ndarray, weights: np.ndarray, joins: np.ndarray, takes: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Features and weights after rows were joined to others, and the new row of each old one."""
    keep = np.ones(len(features), bool)
    keep[joins] = False
    step = np.cumsum(keep) - 1
    step[joins] = step[takes]
    left = int(keep.sum())
    total = np.bincount(step, weights, left)
    share = weights / total[step]
    made = np.stack([np.bincount(step, share * column, left) for column in features.T], axis=1)
    between = ((features[:, :3] - made[step, :3]) ** 2).sum(axis=1) / 3
    made[:, 6] += np.bincount(step, share * between, left)
    return made, total, step
