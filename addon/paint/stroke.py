"""Brush stroke over points of a plane or of space, with the brush weight of each point; no bpy."""

import numpy as np

from .brush import Brush


class Stroke:
    """Stroke that grows point by point. Passing a position twice does not paint it twice, so that
    the result does not depend on the number of points of the path."""

    def __init__(self, points: np.ndarray, brush: Brush) -> None:
        """Prepare; paints nothing yet.

        Args:
            points: Positions that can be painted, [N, D].
            brush: Its radius is in the units of the points.
        """
        # Contiguous by axis, because most points are only compared with the brush's box.
        self._axes = np.ascontiguousarray(points.T, np.float32)
        self._brush = brush
        self._last: np.ndarray | None = None
        self.share = np.zeros(len(points), np.float32)
        """Largest brush weight of each point so far, [N]."""

    def to(self, point: np.ndarray) -> np.ndarray:
        """Extend the stroke in a straight line to a point [D]; return the indices [K] of `points`
        whose weight has increased."""
        point = np.asarray(point, np.float64)
        last = point if self._last is None else self._last
        self._last = point
        near = self._near(last, point)
        distances = _from_segment(self._axes[:, near].T.astype(np.float64), last, point)
        share = self._brush.share(distances).astype(np.float32)
        more = share > self.share[near]
        rows = near[more]
        self.share[rows] = share[more]
        return rows

    def _near(self, one: np.ndarray, other: np.ndarray) -> np.ndarray:
        """Indices [K] of points in the box around the brush along a segment."""
        # Python floats, because numpy scalars would make the comparison double precision.
        low = (np.minimum(one, other) - self._brush.radius).tolist()
        high = (np.maximum(one, other) + self._brush.radius).tolist()
        inside = np.ones(self._axes.shape[1], bool)
        for axis, least, most in zip(self._axes, low, high, strict=True):
            inside &= (axis >= least) & (axis <= most)
        return np.flatnonzero(inside)


def _from_segment(points: np.ndarray, one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Distances [K] of points [K, D] from the segment between two points [D]."""
    way = other - one
    length = way @ way
    along = np.clip((points - one) @ way / length, 0, 1) if length > 0 else np.zeros(len(points))
    return np.linalg.norm(points - one - along[:, None] * way, axis=1)
