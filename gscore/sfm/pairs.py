"""Image pairs to match: exhaustive, or sequence neighbours plus nearby photos and similar ones, by
their visual words."""

from collections.abc import Iterable
from itertools import combinations, product
from pathlib import PurePosixPath

import numpy as np

from .photos import Photo

_SEED = 0
_SAMPLED = 400
"""Maximum number of features used per photo."""
_WORDS = 1024
_CLUSTERED = 20_000
"""Maximum number of features for the vocabulary."""
_ROUNDS = 5
"""Iterations of k-means."""
_ROWS = 8192
"""Number of features compared with all words at a time."""


def most_similar(descriptors: list[np.ndarray], count: int) -> np.ndarray:
    """Indices [n, count] int64 of the photos most similar to each photo, best first; -1 where no
    other photo shares a word.

    By a bag of visual words (Sivic and Zisserman 2003): each feature is assigned to a cluster, its
    word; photos that share rare words are similar.

    Args:
        descriptors: Descriptors of each photo, [m, d], any number type; m may be 0.
        count: Number per photo, less than the number of photos.
    """
    rng = np.random.default_rng(_SEED)
    sampled = [_some(each, _SAMPLED, rng).astype(np.float32) for each in descriptors]
    joined = np.concatenate(sampled)
    owners = np.repeat(np.arange(len(sampled)), [len(each) for each in sampled])
    if not len(joined):
        return np.full((len(sampled), count), -1)
    words = _nearest(joined, _vocabulary(_some(joined, _CLUSTERED, rng), rng))
    similarity = _similarity(owners, words, len(sampled))
    np.fill_diagonal(similarity, 0.0)
    order = np.argsort(-similarity, axis=1, kind="stable")[:, :count]
    return np.where(np.take_along_axis(similarity, order, axis=1) > 0, order, -1)


def _similarity(owners: np.ndarray, words: np.ndarray, photos: int) -> np.ndarray:
    """Cosine similarities [n, n] of the photos' word counts, with inverse document frequency."""
    counts = np.zeros((photos, _WORDS))
    np.add.at(counts, (owners, words), 1.0)
    having = (counts > 0).sum(axis=0)
    weighed = np.sqrt(counts) * np.log(photos / np.maximum(having, 1))
    weighed /= np.maximum(np.linalg.norm(weighed, axis=1, keepdims=True), 1e-12)
    return weighed @ weighed.T


def _vocabulary(features: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Cluster centres [w, d] float32 of features (k-means); w is at most `_WORDS`."""
    centers = _some(features, _WORDS, rng)
    for _ in range(_ROUNDS):
        clusters = _nearest(features, centers)
        sizes = np.bincount(clusters, minlength=len(centers))
        sums = np.zeros_like(centers)
        np.add.at(sums, clusters, features)
        centers = np.where(sizes[:, None] > 0, sums / np.maximum(sizes, 1)[:, None], centers)
    return centers


def _nearest(features: np.ndarray, centers: np.ndarray) -> np.ndarray:
    """Index [m] int64 of the centre nearest to each feature."""
    half = 0.5 * (centers**2).sum(axis=1)
    parts = [features[i : i + _ROWS] for i in range(0, len(features), _ROWS)]
    return np.concatenate([np.argmin(half - part @ centers.T, axis=1) for part in parts])


def _some(rows: np.ndarray, most: int, rng: np.random.Generator) -> np.ndarray:
    """A random sample of at most `most` rows, in their order."""
    if len(rows) <= most:
        return rows
    return rows[np.sort(rng.choice(len(rows), most, replace=False))]


Pair = tuple[str, str]
"""Aliases of two photos, the earlier one first."""
EXHAUSTIVE = 120
"""Number of photos up to which matching is exhaustive by default."""
_BLOCK = 10
"""Photos per block; the features of two blocks are in memory at a time."""
_PAIRS = 100
"""Pairs of a sequence that are matched at a time."""
_OVERLAP = 10
"""Following photos that each photo is matched with, besides those at distances 16, 32, 64 ..."""
_LONGEST_JUMP = 512
_SIMILAR, _ADDED = 20, 8
"""Most similar photos considered for each photo, and the maximum number of pairs they add."""
FURTHER_PAIRS = 5
"""Expected number of added pairs per photo: its neighbours are similar too."""
_NEAR = 10
"""Number of nearest photos by GPS to match."""
_KEY_PHOTOS = 40
"""Photos, spread over the sequence, that are all matched with each other: this closes loops."""


def in_parts(photos: list[Photo], *, sequential: bool) -> list[list[Pair]]:
    """All pairs to match, in parts of some seconds each, after which work can stop and resume."""
    if sequential:
        return _cut(sequential_pairs(photos))
    names = [photo.alias for photo in photos]
    blocks = [names[i : i + _BLOCK] for i in range(0, len(names), _BLOCK)]
    parts = []
    for i, first in enumerate(blocks):
        parts.append(list(combinations(first, 2)))
        parts += [list(product(first, second)) for second in blocks[i + 1 :]]
    return [part for part in parts if part]


def sequential_pairs(photos: list[Photo]) -> list[Pair]:
    """Pairs of aliases of photos named in the order in which they were taken.

    Pairs are neighbours, photos at growing distances, and key photos of the whole sequence with
    each other, which closes loops of the camera path. Each folder is a sequence; the key photos of
    all folders join them.
    """
    pairs: set[Pair] = set()
    for run in _runs(photos):
        jumps = [_LONGEST_JUMP >> i for i in range(6)]
        steps = [*range(1, _OVERLAP + 1), *jumps]
        pairs |= {(run[i], run[i + s]) for s in steps for i in range(len(run) - s)}
    stride = -(-len(photos) // _KEY_PHOTOS)
    return sorted(pairs | set(combinations([photo.alias for photo in photos[::stride]], 2)))


def further_parts(
    known: Iterable[Pair], descriptors: dict[str, np.ndarray], places: dict[str, np.ndarray]
) -> list[list[Pair]]:
    """Pairs beyond the sequence: similar photos, which closes loops and joins unordered photos, and
    photos near each other.

    Args:
        known: Pairs that are matched anyway.
        descriptors: Descriptors of each photo, [m, d], by alias.
        places: Positions of photos, [3] metres, by alias; photos without one are missing.
    """
    found, names = set(known), list(descriptors)
    similar = most_similar(list(descriptors.values()), min(_SIMILAR, len(names) - 1))
    added = _new_pairs(found, names, similar, _ADDED)
    if len(places) > _NEAR:
        from scipy.spatial import KDTree  # Blender, which imports this package, has no scipy

        points = np.array(list(places.values()))
        near = np.array(KDTree(points).query(points, k=_NEAR + 1)[1])
        added |= _new_pairs(found | added, list(places), near, _NEAR)
    return _cut(sorted(added))


def _new_pairs(known: set[Pair], names: list[str], others: np.ndarray, most: int) -> set[Pair]:
    """Pairs of each photo with the first `most` of its `others` [n, k] that are not known."""
    added: set[Pair] = set()
    for name, row in zip(names, others.tolist(), strict=True):
        wanted = [names[i] for i in row if i >= 0 and names[i] != name]
        pairs = [(min(name, other), max(name, other)) for other in wanted]
        added |= set([pair for pair in pairs if pair not in known][:most])
    return added


def _cut(pairs: list[Pair]) -> list[list[Pair]]:
    return [pairs[i : i + _PAIRS] for i in range(0, len(pairs), _PAIRS)]


def is_sequential(matching: str, count: int) -> bool:
    """Whether to match in sequence: as requested, or in auto mode for many photos."""
    return matching == "sequential" or (matching == "auto" and count > EXHAUSTIVE)


def _runs(photos: list[Photo]) -> list[list[str]]:
    runs: dict[str, list[str]] = {}
    for photo in photos:
        runs.setdefault(str(PurePosixPath(photo.name).parent), []).append(photo.alias)
    return list(runs.values())
