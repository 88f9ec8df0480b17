"""Neighbouring cameras: pairs between which views are likely."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np

_NEAREST = 12
"""Nearest cameras of each among which its neighbours are searched."""


def neighbours(centers: np.ndarray, names: list[str]) -> Iterator[tuple[int, int]]:
    """Yield pairs of neighbouring cameras in ascending order, each once.

    Neighbours are cameras with successive names, and those with no camera in the ball that has them
    as poles (Gabriel graph, Gabriel and Sokal 1969), tested among the twelve nearest.

    Args:
        centers: [C, 3] float64, positions, any unit.
        names: Names of the photos.
    """
    from scipy.spatial import KDTree

    order = np.argsort(names, kind="stable").tolist()
    pairs = {(min(a, b), max(a, b)) for a, b in pairwise(order)}
    _, nearest = KDTree(centers).query(centers, k=min(_NEAREST + 1, len(centers)))
    for a, row in enumerate(np.asarray(nearest)):
        for b in row[row != a].tolist():
            middle = (centers[a] + centers[b]) / 2
            radius = np.linalg.norm(centers[a] - middle)
            others = [int(c) for c in row if c not in (a, b)]
            if not (np.linalg.norm(centers[others] - middle, axis=1) < radius * (1 - 1e-9)).any():
                pairs.add((min(a, b), max(a, b)))
    yield from sorted(pairs)
