"""Neighbouring cameras: pairs between which views are likely."""

import re
from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from .scene import Cameras

LARGEST_TURN = float(np.cos(np.radians(60)))
"""Cosine of the largest angle between the directions of two cameras that show the same."""
_NEAREST = 12
"""Nearest cameras of each among which its neighbours are searched."""


def natural_key(name: str) -> list[tuple[int, str]]:
    """Key of the natural order, by the values of numbers in names: view_9 before view_10."""
    parts = re.split(r"(\d+)", name)
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]


def neighbours(centers: np.ndarray, names: list[str]) -> Iterator[tuple[int, int]]:
    """Yield pairs of neighbouring cameras in ascending order, each once.

    Neighbours are cameras with successive names in natural order, and those with no camera in the
    ball that has them as poles (Gabriel graph, Gabriel and Sokal 1969), tested among the twelve
    nearest places. Of several cameras at one place only the first counts for the latter; no two
    cameras at one place are neighbours.

    Args:
        centers: [C, 3] float64, positions, any unit.
        names: Names of the photos.
    """
    from scipy.spatial import KDTree

    order = sorted(range(len(names)), key=lambda index: natural_key(names[index]))
    pairs = {(min(a, b), max(a, b)) for a, b in pairwise(order) if (centers[a] != centers[b]).any()}
    first = np.sort(np.unique(centers, axis=0, return_index=True)[1])
    places = centers[first]
    _, nearest = KDTree(places).query(places, k=min(_NEAREST + 1, len(places)))
    for a, row in enumerate(np.asarray(nearest).reshape(len(places), -1)):
        for b in row[row != a].tolist():
            middle = (places[a] + places[b]) / 2
            radius = np.linalg.norm(places[a] - middle)
            others = [int(c) for c in row if c not in (a, b)]
            if not (np.linalg.norm(places[others] - middle, axis=1) < radius * (1 - 1e-9)).any():
                pairs.add((int(first[min(a, b)]), int(first[max(a, b)])))
    yield from sorted(pairs)


def pairs_with_views_between(cameras: Cameras, chosen: Sequence[int]) -> Iterator[tuple[int, int]]:
    """Yield pairs of neighbours among some cameras that look in similar directions, within 60
    degrees, so that new views are likely between them.

    Args:
        cameras: The cameras.
        chosen: Indices of those that are paired.
    """
    looks = cameras.viewmats[chosen][:, 2, :3]
    for a, b in neighbours(cameras.centers[chosen], [cameras.names[i] for i in chosen]):
        if looks[a] @ looks[b] >= LARGEST_TURN:
            yield chosen[a], chosen[b]
