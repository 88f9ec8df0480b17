"""Nearest points: distances to the nearest SfM points."""

import numpy as np

_MANY = 8
"""Ratio of points to queries above which the tree is built by the fast method."""
_LEAF = 64
"""Points per leaf of that tree."""


def few_queries(points: int, queries: int) -> bool:
    """Return whether there are so few queries that a tree that is fast to build pays off."""
    return _MANY * queries < points


class NearestPoints:
    """k-d tree of surface points, built on first use: for millions of points the most expensive
    preparation, in time and, with 40 bytes per point, in memory."""

    def __init__(self, points: np.ndarray, *, queries: int | None = None) -> None:
        """Create the tree.

        Args:
            points: [P, 3] float64, any unit, not copied; points that are not finite are ignored.
            queries: Approximate number of queries; None: the number of points.
        """
        finite = np.isfinite(points).all(axis=1)
        self.points = points if finite.all() else points[finite]
        """[P, 3], the finite points."""
        self._build_fast = queries is not None and few_queries(len(self.points), queries)
        self._tree = None

    def __len__(self) -> int:
        return len(self.points)

    def distances(self, places: np.ndarray, count: int) -> np.ndarray:
        """Return distances from `places`, [Q, 3], to the nearest points, including a point at the
        same position: [Q, count] float64, ascending. Both trees give the same bits."""
        if self._tree is None:
            from scipy.spatial import KDTree

            # A balanced tree pays off for many queries; for few, building it takes more than half
            # of the total time.
            self._tree = (
                KDTree(self.points, leafsize=_LEAF, compact_nodes=False, balanced_tree=False)
                if self._build_fast
                else KDTree(self.points)
            )
        found, _ = self._tree.query(places, k=count)
        return np.asarray(found).reshape(len(places), count)
