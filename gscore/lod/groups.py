"""Which splats become one at a coarser level: neighbours whose joining moves the least."""

import numpy as np

from ..extras import need

_NEIGHBOURS = 6
"""Of which each splat's partner is chosen."""
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
    beside each other. A round joins pairs that are each other's best, cheapest first.

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
        pairs = _pairs(features, weights, len(features) - wanted)
        features, weights, step = _joined(features, weights, pairs)
        group = step[group]
    return group


def _pairs(features: np.ndarray, weights: np.ndarray, most: int) -> np.ndarray:
    """[P, 2] rows that are joined in this round, P at least 1 and at most `most`."""
    count = len(features)
    means, near = features[:, :3], min(_NEIGHBOURS + 1, count)
    tree = need("scipy.spatial", "Making levels of detail").cKDTree(means)
    beside = tree.query(means, k=near)[1].reshape(count, near)
    rows = np.repeat(np.arange(count), near).reshape(count, near)
    costs = np.where(beside == rows, np.inf, _costs(features, weights, rows, beside))
    best = costs.argmin(axis=1)
    mine, partner = costs[np.arange(count), best], beside[np.arange(count), best]
    first = np.flatnonzero((partner[partner] == np.arange(count)) & (partner > np.arange(count)))
    if not len(first):  # rings of equal costs: the cheapest pair of all
        first = np.array([mine.argmin()])
    first = first[np.argsort(mine[first], kind="stable")[:most]]
    return np.stack([first, partner[first]], axis=1)


def _costs(features: np.ndarray, weights: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    apart = features[a, :6] - features[b, :6]
    away = (apart[..., :3] ** 2).sum(axis=-1)
    own = np.maximum(features[a, 6], features[b, 6])
    away = away + _COLOR**2 * own * (apart[..., 3:] ** 2).mean(axis=-1)
    product = weights[a] * weights[b] / (weights[a] + weights[b])
    return product * away / np.maximum(away + own, 1e-300)


def _joined(
    features: np.ndarray, weights: np.ndarray, pairs: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Features and weights after pairs became one, and the new row of each old one."""
    keep = np.ones(len(features), bool)
    keep[pairs[:, 1]] = False
    step = np.cumsum(keep) - 1
    step[pairs[:, 1]] = step[pairs[:, 0]]
    a, b = weights[pairs[:, 0], None], weights[pairs[:, 1], None]
    both = (a * features[pairs[:, 0]] + b * features[pairs[:, 1]]) / (a + b)
    between = ((features[pairs[:, 0], :3] - features[pairs[:, 1], :3]) ** 2).sum(axis=1) / 3
    both[:, 6] += (a * b / (a + b) ** 2)[:, 0] * between
    features, weights = features.copy(), weights.copy()
    features[pairs[:, 0]] = both
    weights[pairs[:, 0]] += weights[pairs[:, 1]]
    return features[keep], weights[keep], step
