"""Which splats hang together: ellipsoids in cells of space that touch, without a gap."""

import itertools

import numpy as np

from ..splats import Splats
from ..transforms import quat_to_rotmat

_REACH = 2.0
"""Standard deviations as far as an ellipsoid goes; there it has an eighth of its opacity."""
_STEPS = (-1.0, -0.5, 0.5, 1.0)
"""Places along an axis of an ellipsoid, as shares of its reach, that it joins to its middle."""
_EXPONENT = 88.0
"""Of scales, at most: float32 holds no more, and squares stay finite."""
_BITS = 20
"""Of a cell's number along an axis."""
_FORWARD = [step for step in itertools.product((-1, 0, 1), repeat=3) if step > (0, 0, 0)]
"""Half of the 26 cells around one; the other half sees it from there."""


def cluster_sizes(splats: Splats, gap: float) -> np.ndarray:
    """How many splats belong to the cluster of each.

    Space is cut into cells. Splats in the same cell or in cells that touch, at corners too, belong
    together, and a large splat counts in the cells that its axes reach: those of a background lie
    far apart and yet without a gap. Beyond the middle of the model cells grow with the distance.

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
    distances = np.linalg.norm(means - middle, axis=1)
    size = float(np.median(distances)) or 1.0
    grown = size * np.maximum(distances / size, 1)
    ends, owners = _ends(splats, means, gap / 2 * grown)
    places = _near_and_far((np.concatenate([means, ends]) - middle) / size)
    keys, home = _cells(places / gap)
    home, of_ends = home[: len(means)], home[len(means) :]
    first, second = _touching(keys)
    labels = _components(
        len(keys),
        np.concatenate([first, home[owners]]),
        np.concatenate([second, of_ends]),
    )[home]
    return np.bincount(labels, minlength=len(keys))[labels]


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
    keys, home = _cells((places - np.median(places[seeds], axis=0)) / gap)
    labels = _components(len(keys), *_touching(keys))[home]
    found = np.zeros(len(keys), bool)
    found[labels[seeds]] = True
    return found[labels]


def _cells(places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The sorted keys of the cells, of side 1, that hold any of the places [M, 3], and the number
    [M] of each place's own."""
    half = 1 << (_BITS - 1)
    cells = np.clip(places, 2 - half, half - 2)  # one to spare on each side
    return np.unique(_key(np.floor(cells).astype(np.int64) + half), return_inverse=True)


def _ends(splats: Splats, means: np.ndarray, shortest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places [M, 3] along the axes of ellipsoids that reach farther than `shortest` [N], and the
    row [M] that each belongs to."""
    reaches = _REACH * np.exp(np.minimum(splats.scales.astype(np.float64), _EXPONENT))
    places, owners = [np.zeros((0, 3))], [np.zeros(0, np.int64)]
    for axis in range(3):
        rows = np.flatnonzero(reaches[:, axis] > shortest)
        turned = quat_to_rotmat(splats.quats[rows].astype(np.float64))[:, :, axis]
        for step in _STEPS:
            places.append(means[rows] + step * turned * reaches[rows, axis, None])
            owners.append(rows)
    return np.concatenate(places), np.concatenate(owners)


def _near_and_far(places: np.ndarray) -> np.ndarray:
    """Places in units of the model's size; a distance beyond 1 becomes 1 + its logarithm."""
    distances = np.linalg.norm(places, axis=1)
    shrink = np.ones(len(places))
    far = distances > 1
    shrink[far] = (1 + np.log(distances[far])) / distances[far]
    return places * shrink[:, None]


def _key(cells: np.ndarray) -> np.ndarray:
    """[M] int64, one number for each cell [M, 3], by which neighbours are a fixed step apart."""
    return cells[:, 0] << (2 * _BITS) | cells[:, 1] << _BITS | cells[:, 2]


def _touching(keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of places in the sorted `keys` whose cells touch."""
    first, second = [], []
    for x, y, z in _FORWARD:
        wanted = keys + ((x << (2 * _BITS)) + (y << _BITS) + z)
        at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        there = np.flatnonzero(keys[at] == wanted)
        first.append(there)
        second.append(at[there])
    return np.concatenate(first), np.concatenate(second)


def _components(count: int, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """[count] int64, the same number for all nodes that pairs connect: the least of them.

    Roots are hung under the least root beyond their pairs, then paths are shortened, until no pair
    joins two trees any more: a few rounds, since trees grow like powers of two.
    """
    labels = np.arange(count)
    while True:
        low, high = np.sort(np.stack([labels[first], labels[second]]), axis=0)
        apart = low != high
        if not apart.any():
            return labels
        first, second = first[apart], second[apart]
        np.minimum.at(labels, high[apart], low[apart])
        while not np.array_equal(labels, shorter := labels[labels]):
            labels = shorter
