"""Clusters of connected splats: ellipsoids that touch without a gap, found by cells of space."""

import math

import numpy as np

from ..splats import Splats
from ..transforms import quat_to_rotmat

_REACH = 2.0
"""Standard deviations as far as an ellipsoid goes; there it has an eighth of its opacity."""
_STEPS = (-1.0, -0.5, 0.5, 1.0)
"""Places along an axis of an ellipsoid, as shares of its reach, that it joins to its middle."""
_FEW, _MOST = 4, 96
"""Places that a large ellipsoid is filled with besides, the larger the more."""
_PLACES = 0.3
"""Of them, times the square of the reach in half cells: a disc of up to six cells' reach has three
in each square of three by three cells. Of larger ones that overlap most still meet."""
_ALL = 4_000_000
"""Of them for all splats, at most: beyond it only the largest are filled."""
_EXPONENT = 88.0
"""Of scales, at most: float32 holds no more, and squares stay finite."""
_BITS = 20
"""Of a cell's number along an axis."""
_TABLE = 1 << 24
"""Cells of a box, at most, of which a table is kept."""
_BLOCK = 1 << 13
"""Splats whose places are computed at once; they stay in the cache."""


def cluster_sizes(splats: Splats, gap: float) -> np.ndarray:
    """How many splats belong to the cluster of each.

    Space is cut into cells. Splats in the same cell or in cells that touch, at corners too, belong
    together, and a large splat counts in cells spread over its ellipsoid: those of a wall or of a
    background lie far apart and yet without a gap. One that holds the middle of the model, as a
    sky does, belongs to what is there. Beyond the middle cells grow with the distance.

    Args:
        splats: Finite.
        gap: Side of a cell, as a share of the model's size: the median distance of its splats from
            their median place.

    Returns:
        [N] int64.
    """
    if len(splats) == 0:
        return np.zeros(0, np.int64)
    means = splats.means.astype(np.float64)
    middle = np.median(means, axis=0)
    distances = _lengths(means - middle)
    size = float(np.median(distances)) or 1.0
    shortest = gap / 2 * size * np.maximum(distances / size, 1)
    heart = means[np.argmin(distances)]
    reaches = _REACH * np.exp(np.minimum(splats.scales.astype(np.float64), _EXPONENT))
    counts = _fill(reaches, shortest)
    middles, ends, owners = [], [], []
    for at in range(0, len(means), _BLOCK):
        part = slice(at, at + _BLOCK)
        axes = splats.quats[part], reaches[part]
        places, rows = _reached(means[part], *axes, shortest[part], counts[part], heart)
        found = _keys(_near_and_far((places - middle) / size) / gap)
        further = np.flatnonzero(found != found[rows])
        middles.append(found[: len(shortest[part])])
        ends.append(found[further])
        owners.append(at + rows[further])
    cells, home = _numbered(np.concatenate(middles + ends))
    own, of_ends = home[: len(means)], home[len(means) :]
    labels = _merged(np.arange(len(cells)), *_touching(cells))
    labels = _merged(labels, own[np.concatenate(owners)], of_ends)[own]
    return np.bincount(labels, minlength=len(cells))[labels]


def reached_from(means: np.ndarray, seeds: np.ndarray, gap: float) -> np.ndarray:
    """Which places can be reached from others without a gap.

    Space is cut into cells; places in the same cell or in cells that touch, at corners too, belong
    together.

    Args:
        means: [N, 3], finite.
        seeds: [N] bool, where it begins.
        gap: Side of a cell, units of `means`, above 0.

    Returns:
        [N] bool, the seeds among them.
    """
    if not seeds.any():
        return np.zeros(len(means), bool)
    places = means.astype(np.float64)
    cells, home = _numbered(_keys((places - np.median(places[seeds], axis=0)) / gap))
    labels = _merged(np.arange(len(cells)), *_touching(cells))[home]
    found = np.zeros(len(cells), bool)
    found[labels[seeds]] = True
    return found[labels]


def _fill(reaches: np.ndarray, shortest: np.ndarray) -> np.ndarray:
    """[N] int: with how many places ellipsoids are filled that reach so far [N, 3] along their
    axes, where an axis counts from a reach of `shortest` [N] on."""
    ratios = reaches.max(axis=1) / shortest
    few = np.minimum(ratios, _MOST)
    counts = np.minimum((_PLACES * few * few).astype(int), _MOST)
    counts[counts < _FEW] = 0
    if counts.sum() > _ALL:
        order = np.argsort(-ratios, kind="stable")
        counts[order[np.cumsum(counts[order]) > _ALL]] = 0
    return counts


def _reached(
    means: np.ndarray,
    quats: np.ndarray,
    reaches: np.ndarray,
    shortest: np.ndarray,
    counts: np.ndarray,
    heart: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Places [M, 3] that some splats join: the middles of all; those along axes that reach farther
    than `shortest` [B]; `counts` [B] all over ellipsoids, and `heart` [3] where a large one holds
    it. And the row [M] in the part that each belongs to."""
    rows = np.flatnonzero((reaches > shortest[:, None]).any(axis=1))
    axes = quat_to_rotmat(quats[rows].astype(np.float64)) * reaches[rows, None, :]
    places, owners = [means], [np.arange(len(means))]
    for axis in range(3):
        long = reaches[rows, axis] > shortest[rows]
        arm, own = axes[long, :, axis], rows[long]
        places += [means[own] + step * arm for step in _STEPS]
        owners += [own] * len(_STEPS)
    large = counts[rows] > 0
    axes, rows = axes[large], rows[large]
    counts = counts[rows]
    of = np.repeat(np.arange(len(rows)), counts)
    ball = _ball()[np.arange(len(of)) - np.repeat(np.cumsum(counts) - counts, counts)]
    places.append(means[rows[of]] + np.einsum("nij,nj->ni", axes[of], ball))
    owners.append(rows[of])
    inside = _holds(axes, heart - means[rows])
    places.append(np.tile(heart, (int(inside.sum()), 1)))
    owners.append(rows[inside])
    return np.concatenate(places), np.concatenate(owners)


def _ball() -> np.ndarray:
    """[_MOST, 3] places in the unit ball, of which the first few are spread evenly too: always the
    same ones, of a sequence of low discrepancy (steps of 1/g, 1/g^2, 1/g^3 with g^4 = g + 1;
    Roberts 2018)."""
    n = np.arange(_MOST)[:, None] + 0.5
    radius, height, turn = (n * [0.8191725134, 0.6710436067, 0.5497004779] % 1).T
    z, angle = 1 - 2 * height, 2 * np.pi * turn
    ring = np.sqrt(1 - z * z)
    directions = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)
    return np.cbrt(radius)[:, None] * directions


def _holds(axes: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """[L] bool: ellipsoids around 0, by their axes [L, 3, 3] in columns, that offsets [L, 3] lie
    in. The columns are orthogonal, so the shares along them are offset . axis / |axis|^2."""
    squares = np.maximum((axes * axes).sum(axis=1), np.finfo(float).tiny)
    shares = (axes * offsets[:, :, None]).sum(axis=1) / squares
    return (shares * shares).sum(axis=1) <= 1


def _near_and_far(places: np.ndarray) -> np.ndarray:
    """Places in units of the model's size; a distance beyond 1 becomes 1 + its logarithm."""
    distances = _lengths(places)
    shrink = np.ones(len(places))
    far = distances > 1
    shrink[far] = (1 + np.log(distances[far])) / distances[far]
    return places * shrink[:, None]


def _lengths(vectors: np.ndarray) -> np.ndarray:
    """[M] of vectors [M, 3], to the bit as np.linalg.norm has them, which sums rows one by one."""
    x, y, z = vectors.T
    return np.sqrt(x * x + y * y + z * z)


def _keys(places: np.ndarray) -> np.ndarray:
    """[M] int64, the cell of side 1 that each place [M, 3] lies in: a number by which neighbours
    are a fixed step apart."""
    half = 1 << (_BITS - 1)
    cells = np.floor(np.clip(places, 2 - half, half - 2)).astype(np.int64)  # one to spare
    return _packed(*(cells + half).T)


def _packed(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    return x << (2 * _BITS) | y << _BITS | z


def _numbered(keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The cells [C] that hold any of the places whose keys [M] are given, sorted, and the number
    [M] of each place's own; by a table where they lie in a small box, else by sorting."""
    mask = (1 << _BITS) - 1
    axes = [keys >> (2 * _BITS), keys >> _BITS & mask, keys & mask]
    low = [int(axis.min()) for axis in axes]
    sides = [int(axis.max()) - least + 1 for axis, least in zip(axes, low, strict=True)]
    if math.prod(sides) > _TABLE:
        return np.unique(keys, return_inverse=True)
    flat = np.ravel_multi_index([a - least for a, least in zip(axes, low, strict=True)], sides)
    held = np.zeros(math.prod(sides), bool)
    held[flat] = True
    found = np.flatnonzero(held)
    number = np.empty(len(held), np.int64)
    number[found] = np.arange(len(found))
    places = np.unravel_index(found, sides)
    return _packed(*(p + least for p, least in zip(places, low, strict=True))), number[flat]


def _touching(cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of places in the sorted `cells` of which each touches the other; every pair once."""
    last = len(cells) - 1
    beside = np.flatnonzero(np.diff(cells) == 1)
    first, second = [beside], [beside + 1]
    for x, y in ((0, 1), (1, -1), (1, 0), (1, 1)):
        wanted = cells + ((x << (2 * _BITS)) + (y << _BITS))
        at = np.searchsorted(cells, wanted - 1)
        for further in range(3):  # the three of a column follow one another
            other = np.minimum(at + further, last)
            there = np.flatnonzero((np.abs(cells[other] - wanted) <= 1) & (at + further <= last))
            first.append(there)
            second.append(other[there])
    return np.concatenate(first), np.concatenate(second)


def _merged(labels: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """[C] int64: labels [C] of nodes after pairs have connected some: the same for all that hang
    together, the least of theirs. A label is a node that has it itself.

    Roots are hung under the least root beyond their pairs, then paths are shortened, until no pair
    joins two trees any more: a few rounds, since trees grow like powers of two.
    """
    while True:
        one, other = labels[first], labels[second]
        apart = np.flatnonzero(one != other)
        if not len(apart):
            return labels
        one, other, first, second = one[apart], other[apart], first[apart], second[apart]
        labels = labels.copy()
        np.minimum.at(labels, np.maximum(one, other), np.minimum(one, other))
        while not np.array_equal(labels, shorter := labels[labels]):
            labels = shorter
