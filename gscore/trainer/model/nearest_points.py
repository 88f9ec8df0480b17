"""Nearest points: distances to the nearest SfM points."""

import numpy as np

_MANY = 8
"""So many times as many points as places that are asked for: the tree is made in a hurry."""
_LEAF = 64
"""Points of a leaf of that tree."""


def few_queries(points: int, asked: int) -> bool:
    """Whether the tree is made in a hurry, and smaller, because few places are asked for."""
    return _MANY * asked < points


class NearestPoints:
    """Points of surfaces, and a tree of them that is made when it is first needed: for millions of
    points the dearest thing before the first step, in time and, with 40 bytes a point, in memory.
    """

    def __init__(self, points: np.ndarray, *, asked: int | None = None) -> None:
        """Take over points [P, 3] float64, in any unit; those not finite are left out.

        Args:
            points: Not to be changed while this is in use.
            asked: About how many places will be asked for; None: as many as there are points.
        """
        finite = np.isfinite(points).all(axis=1)
        self.points = points if finite.all() else points[finite]
        """[P, 3], those that are finite."""
        self._hurry = asked is not None and few_queries(len(self.points), asked)
        self._tree = None

    def __len__(self) -> int:
        return len(self.points)

    def distances(self, places: np.ndarray, count: int) -> np.ndarray:
        """[Q, count] float64, rising: from each place [Q, 3] to its nearest points, the place
        itself among them if it is one. The same bits from either tree."""
        if self._tree is None:
            from scipy.spatial import KDTree

            # Sorting points evenly pays when each is asked for, and takes more than half of the
            # time of all else when few are.
            self._tree = (
                KDTree(self.points, leafsize=_LEAF, compact_nodes=False, balanced_tree=False)
                if self._hurry
                else KDTree(self.points)
            )
        found, _ = self._tree.query(places, k=count)
        return np.asarray(found).reshape(len(places), count)
