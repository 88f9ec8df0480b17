"""Brush: its strokes, and its effects on the splats under it; no bpy."""

from dataclasses import dataclass

import numpy as np

from ..core import rgb_to_sh0

COLOR, OPACITY, SELECT, CLONE = "COLOR", "OPACITY", "SELECT", "CLONE"


@dataclass(frozen=True, kw_only=True)
class Brush:
    """Brush of one stroke."""

    radius: float
    """Radius in pixels of the painted view, or in world units for points in space."""
    does: str = COLOR
    """COLOR, OPACITY or SELECT: the changed attribute; SELECT changes the selection only, CLONE
    copies splats."""
    strength: float = 1.0
    """Blending weight of the target in the centre of the brush, per stroke, 0 to 1; of CLONE the
    opacity of copies, in that of their sources."""
    hardness: float = 0.5
    """Share of the radius with full weight, 0 to 1."""
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Target, sRGB values."""
    opacity: float = 0.0
    """Target, 0 to 1."""
    inverted: bool = False
    """Paint the opacity 1 - `opacity`, or deselect. No effect on colours."""

    def __post_init__(self) -> None:
        if not 0 < self.radius < np.inf:
            raise ValueError(f"The brush radius must be above 0, got {self.radius}.")
        for name in ("strength", "hardness", "opacity"):
            value = getattr(self, name)
            if not 0 <= value <= 1:
                raise ValueError(f"The brush {name} must be between 0 and 1, got {value}.")

    def share(self, distances: np.ndarray) -> np.ndarray:
        """Brush weights [K] in [0, 1] at distances [K] from its centre.

        1 up to the hard part's edge; from there 1 - u^2 (3 - 2 u), u from 0 to 1 at the radius.
        """
        beyond = distances - self.hardness * self.radius
        soft = max((1 - self.hardness) * self.radius, 1e-6 * self.radius)
        u = np.clip(beyond / soft, 0, 1)
        return 1 - u * u * (3 - 2 * u)

    def painted(self, base: np.ndarray, share: np.ndarray) -> np.ndarray:
        """`radiance:base` after a stroke, [K, 4] float32; view-dependent coefficients are kept.

        Args:
            base: [K, 4] float32 before the stroke.
            share: Largest weights of the stroke, [K], as from `share`.
        """
        out = base.copy()
        way = (self.strength * share).astype(np.float32)
        if self.does == COLOR:
            target = rgb_to_sh0(np.array(self.color, np.float64)).astype(np.float32)
            out[:, :3] = (1 - way)[:, None] * base[:, :3] + way[:, None] * target
        elif self.does == OPACITY:
            target = np.float32(1 - self.opacity if self.inverted else self.opacity)
            out[:, 3] = (1 - way) * base[:, 3] + way * target
        return out


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
