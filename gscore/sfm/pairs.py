"""Which photos are compared with which: all with all, or neighbours and far ones of a sequence."""

from itertools import combinations, product
from pathlib import PurePosixPath

from .photos import Photo

Pair = tuple[str, str]
"""Aliases of two photos, the earlier one first."""
EXHAUSTIVE = 120
"""Photos up to which all are compared with all, where nothing else is asked for."""
_BLOCK = 10
"""Photos of a block whose features are in memory at the same time as those of another block."""
_PAIRS = 100
"""Pairs of a sequence that are compared at a time."""
_OVERLAP = 10
"""Photos after it that each is compared with, and as many at distances 16, 32, 64 ..."""
_LONGEST_JUMP = 512
_KEY_PHOTOS = 40
"""Photos, spread over the sequence, that are all compared with each other: this closes loops."""


def in_parts(photos: list[Photo], *, sequential: bool) -> list[list[Pair]]:
    """All pairs to compare, in parts of some seconds each, after which work can stop and go on."""
    if sequential:
        pairs = sequential_pairs(photos)
        return [pairs[i : i + _PAIRS] for i in range(0, len(pairs), _PAIRS)]
    names = [photo.alias for photo in photos]
    blocks = [names[i : i + _BLOCK] for i in range(0, len(names), _BLOCK)]
    parts = []
    for i, first in enumerate(blocks):
        parts.append(list(combinations(first, 2)))
        parts += [list(product(first, second)) for second in blocks[i + 1 :]]
    return [part for part in parts if part]


def sequential_pairs(photos: list[Photo]) -> list[Pair]:
    """Pairs of aliases of photos whose names tell the order in which they were taken.

    Neighbours are compared, photos at growing distances, and some photos of the whole sequence with
    each other, so that a path that comes back to where it was is joined there. Each folder is a
    sequence; the photos spread over all join them.
    """
    pairs: set[Pair] = set()
    for run in _runs(photos):
        jumps = [_LONGEST_JUMP >> i for i in range(6)]
        steps = [*range(1, _OVERLAP + 1), *jumps]
        pairs |= {(run[i], run[i + s]) for s in steps for i in range(len(run) - s)}
    stride = -(-len(photos) // _KEY_PHOTOS)
    return sorted(pairs | set(combinations([photo.alias for photo in photos[::stride]], 2)))


def is_sequential(matching: str, count: int) -> bool:
    """Whether to compare by order: as asked for, else where there are many photos."""
    return matching == "sequential" or (matching == "auto" and count > EXHAUSTIVE)


def _runs(photos: list[Photo]) -> list[list[str]]:
    runs: dict[str, list[str]] = {}
    for photo in photos:
        runs.setdefault(str(PurePosixPath(photo.name).parent), []).append(photo.alias)
    return list(runs.values())
