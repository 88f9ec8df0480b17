"""Groups of splats that are merged at a coarser level: neighbours whose merge changes the least."""

import numpy as np

from ..extras import need
from ..io.lod_index import CHILDREN

_NEIGHBOURS = 6
"""Number of neighbours among which each splat's partner is chosen."""
_FEW = 30
"""One-sided joins are allowed if less than one in this many rows is in a mutual pair."""
_A_ROUND = 8
"""At most one in this many rows is joined per round, because costs change as groups grow."""
_COLOR = 5.0
"""Distance for a difference of 1 in all colours, in standard deviations of the larger splat."""


def groups_of(
    means: np.ndarray, weights: np.ndarray, sizes: np.ndarray, colors: np.ndarray, count: int
) -> np.ndarray:
    """[N] int64, the group of each splat, from 0 to `count` - 1.

    The cheapest pairs are joined first, as in Ward (1963): two groups of weights a and b at a
    distance d cost a b / (a + b) times d^2 / (d^2 + s^2), where s is the size of the larger one.
    So small splats are joined before large ones, and overlapping ones before separate ones. A round
    joins mutually best pairs, cheapest first.

    Args:
        means: [N, 3] float64.
        weights: [N] float64, above 0: covered areas.
        sizes: [N] float64, standard deviations, world units.
        colors: [N, 3] float64, about 0 to 1.
        count: Number of groups, 1 to N.

    Raises:
        BackendError: scipy is not installed.
    """
    group = np.arange(len(means))
    features = np.concatenate([means, colors, sizes[:, None] ** 2], axis=1)
    weights = weights / weights.max()
    while len(features) > count:
        joins, takes = _round(features, weights, len(features) - count)
        features, weights, step = _joined(features, weights, joins, takes)
        group = step[group]
    return group


def _round(features: np.ndarray, weights: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows [P] to join and their targets [P] in this round, P at least 1 and at most `most`.

    Of a mutually best pair the heavier row is the target. If there are few such pairs, because many
    small splats surround a large one, every second row is the target of all whose best it is.
    """
    count = len(features)
    means, near = features[:, :3], min(_NEIGHBOURS + 1, count)
    tree = need("scipy.spatial", "Making levels of detail").cKDTree(means)
    neighbours = tree.query(means, k=near)[1].reshape(count, near)
    rows = np.repeat(np.arange(count), near).reshape(count, near)
    costs = np.where(neighbours == rows, np.inf, _costs(features, weights, rows, neighbours))
    best = costs.argmin(axis=1)
    all_rows = np.arange(count)
    mine, partner = costs[all_rows, best], neighbours[all_rows, best]
    mutual = np.flatnonzero((partner[partner] == all_rows) & (partner > all_rows))
    if not len(mutual):  # cycles of equal costs: the cheapest pair
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
    """Features and weights after joining rows, and the new row of each old one."""
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
