"""Brush stroke over points of a plane or of space, with the brush weight of each point; no bpy."""

import numpy as np

from .brush import Brush


class Stroke:
    """Grows point by point. Going over a place twice does not paint it twice, so that a stroke is
    the same however finely the way is cut into points."""

    def __init__(self, points: np.ndarray, brush: Brush) -> None:
        """Nothing is painted yet.

        Args:
            points: [N, D], where the brush can find what it paints.
            brush: Its radius is a length among the points.
        """
        # An axis by itself, because most are compared with the brush's box and nothing more.
        self._axes = np.ascontiguousarray(points.T, np.float32)
        self._brush = brush
        self._last: np.ndarray | None = None
        self.share = np.zeros(len(points), np.float32)
        """[N] largest brush weight of each point so far."""

    def to(self, point: np.ndarray) -> np.ndarray:
        """Extend the stroke straight to a point [D]; indices [K] of `points` with more weight."""
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
        # Python's own numbers: with numpy's all points would be compared in double precision.
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
