"""Clusters of connected splats: ellipsoids without a gap between them, found on a grid."""

import math

import numpy as np

from ..splats import Splats
from ..transforms import quat_to_rotmat

_REACH = 2.0
"""Extent of an ellipsoid in standard deviations; there it has an eighth of its opacity."""
_STEPS = (-1.0, -0.5, 0.5, 1.0)
"""Sample points along each axis of an ellipsoid, as shares of its reach."""
_FEW, _MOST = 4, 96
"""Least and largest number of sample points inside a large ellipsoid."""
_PLACES = 0.3
"""Number of sample points per square of the reach in half cells: a disc with a reach of up to six
cells has three in each square of three by three cells. Larger overlapping ones usually still
meet."""
_ALL = 4_000_000
"""Most sample points of all splats; beyond it only the largest splats are filled."""
_EXPONENT = 88.0
"""Largest log scale, the limit of float32, so that squares stay finite."""
_BITS = 20
"""Bits of a cell's number along an axis."""
_TABLE = 1 << 24
"""Most cells of a box with a lookup table."""
_BLOCK = 1 << 13
"""Splats whose sample points are computed at a time, to stay in cache."""


def cluster_sizes(splats: Splats, gap: float) -> np.ndarray:
    """Number of splats in the cluster of each splat.

    Space is divided into cells. Splats in the same or adjacent cells, also at corners, are
    connected. A large splat occupies cells spread over its ellipsoid, because centres of splats in
    a wall or background are far apart although there is no gap. A splat around the middle of the
    model, such as a sky, is connected to the splats there. Cells grow with the distance from the
    middle.

    Args:
        splats: Splats with finite parameters.
        gap: Side of a cell, as a share of the model's size: the median distance of its splats from
            their median position.

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
        points, rows = _sampled(means[part], *axes, shortest[part], counts[part], heart)
        keys = _keys(_near_and_far((points - middle) / size) / gap)
        further = np.flatnonzero(keys != keys[rows])
        middles.append(keys[: len(shortest[part])])
        ends.append(keys[further])
        owners.append(at + rows[further])
    cells, home = _numbered(np.concatenate(middles + ends))
    own, of_ends = home[: len(means)], home[len(means) :]
    labels = _merged(np.arange(len(cells)), *_touching(cells))
    labels = _merged(labels, own[np.concatenate(owners)], of_ends)[own]
    return np.bincount(labels, minlength=len(cells))[labels]


def reached_from(means: np.ndarray, seeds: np.ndarray, gap: float) -> np.ndarray:
    """Mask of the positions connected to the seeds without a gap.

    Space is divided into cells; positions in the same or adjacent cells, also at corners, are
    connected.

    Args:
        means: [N, 3], finite.
        seeds: [N] bool, start positions.
        gap: Side of a cell, units of `means`, above 0.

    Returns:
        [N] bool, including the seeds.
    """
    if not seeds.any():
        return np.zeros(len(means), bool)
    points = means.astype(np.float64)
    cells, home = _numbered(_keys((points - np.median(points[seeds], axis=0)) / gap))
    labels = _merged(np.arange(len(cells)), *_touching(cells))[home]
    reached = np.zeros(len(cells), bool)
    reached[labels[seeds]] = True
    return reached[labels]


def _fill(reaches: np.ndarray, shortest: np.ndarray) -> np.ndarray:
    """[N] int, number of inner sample points of ellipsoids by their `reaches` [N, 3] along the
    axes; `shortest` [N] is the reach from which an axis is sampled."""
    ratios = reaches.max(axis=1) / shortest
    few = np.minimum(ratios, _MOST)
    counts = np.minimum((_PLACES * few * few).astype(int), _MOST)
    counts[counts < _FEW] = 0
    if counts.sum() > _ALL:
        order = np.argsort(-ratios, kind="stable")
        counts[order[np.cumsum(counts[order]) > _ALL]] = 0
    return counts


def _sampled(
    means: np.ndarray,
    quats: np.ndarray,
    reaches: np.ndarray,
    shortest: np.ndarray,
    counts: np.ndarray,
    heart: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Sample points [M, 3] of some splats and the row [M] of each: all centres; points along axes
    that reach farther than `shortest` [B]; `counts` [B] points inside ellipsoids; and `heart` [3]
    for large ones that contain it."""
    rows = np.flatnonzero((reaches > shortest[:, None]).any(axis=1))
    axes = quat_to_rotmat(quats[rows].astype(np.float64)) * reaches[rows, None, :]
    points, owners = [means], [np.arange(len(means))]
    for axis in range(3):
        long = reaches[rows, axis] > shortest[rows]
        arm, own = axes[long, :, axis], rows[long]
        points += [means[own] + step * arm for step in _STEPS]
        owners += [own] * len(_STEPS)
    large = counts[rows] > 0
    axes, rows = axes[large], rows[large]
    counts = counts[rows]
    of = np.repeat(np.arange(len(rows)), counts)
    ball = _ball()[np.arange(len(of)) - np.repeat(np.cumsum(counts) - counts, counts)]
    points.append(means[rows[of]] + np.einsum("nij,nj->ni", axes[of], ball))
    owners.append(rows[of])
    inside = _holds(axes, heart - means[rows])
    points.append(np.tile(heart, (int(inside.sum()), 1)))
    owners.append(rows[inside])
    return np.concatenate(points), np.concatenate(owners)


def _ball() -> np.ndarray:
    """[_MOST, 3] fixed points in the unit ball, a low-discrepancy sequence whose first few are also
    evenly spread (steps of 1/g, 1/g^2, 1/g^3 with g^4 = g + 1; Roberts 2018)."""
    n = np.arange(_MOST)[:, None] + 0.5
    radius, height, turn = (n * [0.8191725134, 0.6710436067, 0.5497004779] % 1).T
    z, angle = 1 - 2 * height, 2 * np.pi * turn
    ring = np.sqrt(1 - z * z)
    directions = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)
    return np.cbrt(radius)[:, None] * directions


def _holds(axes: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Mask [L] bool of the offsets [L, 3] inside ellipsoids around 0, axes [L, 3, 3] in columns.
    The columns are orthogonal, so the shares along them are offset . axis / |axis|^2."""
    squares = np.maximum((axes * axes).sum(axis=1), np.finfo(float).tiny)
    shares = (axes * offsets[:, :, None]).sum(axis=1) / squares
    return (shares * shares).sum(axis=1) <= 1


def _near_and_far(points: np.ndarray) -> np.ndarray:
    """Contract points [M, 3], in units of the model's size: a distance beyond 1 becomes 1 + its
    logarithm."""
    distances = _lengths(points)
    shrink = np.ones(len(points))
    far = distances > 1
    shrink[far] = (1 + np.log(distances[far])) / distances[far]
    return points * shrink[:, None]


def _lengths(vectors: np.ndarray) -> np.ndarray:
    """[M] lengths of vectors [M, 3], bit-identical to np.linalg.norm, but faster for many rows."""
    x, y, z = vectors.T
    return np.sqrt(x * x + y * y + z * z)


def _keys(points: np.ndarray) -> np.ndarray:
    """[M] int64, key of the cell of side 1 of each point [M, 3]; keys of neighbours differ by a
    fixed step."""
    half = 1 << (_BITS - 1)
    cells = np.floor(np.clip(points, 2 - half, half - 2)).astype(np.int64)  # one to spare
    return _packed(*(cells + half).T)


def _packed(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    return x << (2 * _BITS) | y << _BITS | z


def _numbered(keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sorted unique keys [C] of `keys` [M], and the index [M] of each; by a table if the cells are
    in a small box, else by sorting."""
    mask = (1 << _BITS) - 1
    axes = [keys >> (2 * _BITS), keys >> _BITS & mask, keys & mask]
    low = [int(axis.min()) for axis in axes]
    sides = [int(axis.max()) - least + 1 for axis, least in zip(axes, low, strict=True)]
    if math.prod(sides) > _TABLE:
        return np.unique(keys, return_inverse=True)
    flat = np.ravel_multi_index([a - least for a, least in zip(axes, low, strict=True)], sides)
    occupied = np.zeros(math.prod(sides), bool)
    occupied[flat] = True
    cells = np.flatnonzero(occupied)
    number = np.empty(len(occupied), np.int64)
    number[cells] = np.arange(len(cells))
    xyz = np.unravel_index(cells, sides)
    return _packed(*(p + least for p, least in zip(xyz, low, strict=True))), number[flat]


def _touching(cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of indices of adjacent cells in the sorted `cells`, each pair once."""
    last = len(cells) - 1
    next_to = np.flatnonzero(np.diff(cells) == 1)
    first, second = [next_to], [next_to + 1]
    for x, y in ((0, 1), (1, -1), (1, 0), (1, 1)):
        target = cells + ((x << (2 * _BITS)) + (y << _BITS))
        at = np.searchsorted(cells, target - 1)
        for further in range(3):  # the three cells of a column are consecutive
            other = np.minimum(at + further, last)
            there = np.flatnonzero((np.abs(cells[other] - target) <= 1) & (at + further <= last))
            first.append(there)
            second.append(other[there])
    return np.concatenate(first), np.concatenate(second)


def _merged(labels: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Labels [C] int64 of nodes after connecting pairs: the least label of each component.
    A label is a node whose own label it is.

    Union-find in rounds: roots are linked to the least root of their pairs, then paths are
    compressed, until no pair connects two trees. Few rounds, because trees grow exponentially.
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
