"""Image pairs to match: exhaustive, or sequence neighbours plus similar and nearby photos."""

from collections.abc import Iterable
from itertools import combinations, product
from pathlib import PurePosixPath

import numpy as np

from .photos import Photo
from .retrieval import most_similar

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
