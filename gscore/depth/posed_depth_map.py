"""Posed depth map: a depth map with its camera, for points in the world and their depths.

Values of a map are normalised to tones, 0 at its far end and 1 at its near end, so that two
positive numbers, the inverse depths at the ends, define its scale and offset.
"""

from dataclasses import dataclass

import numpy as np

from ..scene import Cameras
from .confidence import confidence
from .fit import Fit, noise_of
from .maps import sample
from .samples import Samples, grid_step

_ENDS = (0.02, 0.98)
"""Quantiles of a map's values at its ends."""
_LEAST_PIXELS = 50
"""Minimum number of confident pixels of the grid to compare a map with others."""
_SURE = 0.5
"""Minimum confidence of a pixel on a surface, not on an edge."""
_LEAST_POINTS = 8
"""Minimum number of points in a view to use them."""
_FLOOR = 1e-3
"""Minimum inverse depth, relative to that at the near end."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PosedDepthMap:
    """A depth map prepared for comparison with others. P sampled pixels, M points."""

    low: float
    """The map's value at tone 0."""
    high: float
    """The map's value at tone 1, larger."""
    grid: np.ndarray
    """[h, w] float64 tones; NaN: unknown."""
    step: int
    """Pixels between two columns of the grid, and two rows."""
    size: tuple[int, int]
    """Width and height of the camera, px."""
    K: np.ndarray
    """[3, 3], pixels."""
    viewmat: np.ndarray
    """[4, 4], world to camera."""
    tones: np.ndarray
    """[P] float64 at the sampled, confident pixels."""
    directions: np.ndarray
    """[P, 3] rays of these pixels in the world, scaled to camera z = 1."""
    point_tones: np.ndarray
    """[M] float64 at the view's own points."""
    point_inverse: np.ndarray
    """[M] float64 positive, 1/world unit."""
    point_weights: np.ndarray
    """[M] float64, their sum is 1; empty if there are too few points."""

    @property
    def center(self) -> np.ndarray:
        """[3] camera centre, world."""
        return -self.viewmat[:3, :3].T @ self.viewmat[:3, 3]

    def points(self, inverse_depth: np.ndarray) -> np.ndarray:
        """World positions [..., P, 3] of the sampled pixels at inverse depths [..., P]."""
        return self.center + self.directions / inverse_depth[..., None]

    def look_up(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Tones of the map at points, NaN outside the picture, and the points' inverse depths.

        Args:
            points: [..., 3], world.

        Returns:
            [...] and [...] float64; the inverse depth is 1 behind the camera.
        """
        local = points @ self.viewmat[:3, :3].T + self.viewmat[:3, 3]
        front = local[..., 2] > 0
        z = np.where(front, local[..., 2], 1.0)
        pixels = (local @ self.K.T)[..., :2] / z[..., None]
        inside = front & ((pixels >= 0) & (pixels < self.size)).all(axis=-1)
        x, y = (pixels[inside] / self.step - 0.5).T
        tones = np.full(z.shape, np.nan)
        tones[inside] = sample(self.grid, x, y)
        return tones, 1 / z

    def ends(self, fit: Fit) -> np.ndarray | None:
        """[2] inverse depths of a fit at tones 0 and 1; None if one is not positive."""
        ends = fit.scale * np.array([self.low, self.high]) + fit.offset
        return ends if ends[0] > _FLOOR * ends[1] > 0 else None

    def line(self, ends: np.ndarray) -> tuple[float, float]:
        """Scale and offset of a map whose ends have inverse depths [2]."""
        scale = (ends[1] - ends[0]) / (self.high - self.low)
        return float(scale), float(ends[0] - scale * self.low)

    def uncertainty(self, ends: np.ndarray, covariance: np.ndarray) -> dict[str, float]:
        """`center`, `deviation` and `noise` of a Fit, from the uncertainty of its ends.

        Args:
            ends: [2] inverse depths at tones 0 and 1.
            covariance: [2, 2] covariance of their logs.
        """
        # Inverse depth = constant + tone * slope, both linear in the ends.
        constant, slope = np.array([ends[0], 0.0]), np.array([-ends[0], ends[1]])
        least = -(constant @ covariance @ slope) / (slope @ covariance @ slope)
        at = constant + least * slope
        error = float(at @ covariance @ at) ** 0.5
        spread = error / float(slope @ covariance @ slope) ** 0.5
        return {
            "center": float(self.low + least * (self.high - self.low)),
            "deviation": spread * (self.high - self.low),
            "noise": noise_of(error),
        }


def prepare_depth_map(
    samples: Samples, cameras: Cameras, index: int, *, count: int
) -> PosedDepthMap | None:
    """Depth map of view `index` with `count` sampled pixels; None if too few pixels are confident.

    Args:
        samples: Samples of a map that is affine in inverse depth.
        cameras: Cameras at the size of the grid's source.
        index: Index of the view.
        count: P; pixels are drawn at random, with repetition if there are fewer.
    """
    known = np.isfinite(samples.grid)
    sure = known & (confidence(samples.grid, None) >= _SURE)
    row, column = np.nonzero(sure)
    if samples.problem or len(row) < _LEAST_PIXELS:
        return None
    low, high = (float(v) for v in np.quantile(samples.grid[known], _ENDS))
    if not high > low:
        return None
    rng = np.random.default_rng(index)
    chosen = rng.choice(len(row), count, replace=len(row) < count)
    row, column = row[chosen], column[chosen]
    step = grid_step(int(cameras.widths[index]))
    pixels = np.stack([step * (column + 0.5), step * (row + 0.5), np.ones(count)], 1)
    grid = (samples.grid.astype(np.float64) - low) / (high - low)
    seen = np.isfinite(samples.values) & (samples.inverse_depth > 0)
    if int(seen.sum()) < _LEAST_POINTS:
        seen[:] = False
    weights = samples.weights[seen]
    viewmat = cameras.viewmats[index]
    return PosedDepthMap(
        low=low,
        high=high,
        grid=grid,
        step=step,
        size=(int(cameras.widths[index]), int(cameras.heights[index])),
        K=cameras.Ks[index],
        viewmat=viewmat,
        tones=grid[row, column],
        directions=pixels @ np.linalg.inv(cameras.Ks[index]).T @ viewmat[:3, :3],
        point_tones=(samples.values[seen] - low) / (high - low),
        point_inverse=samples.inverse_depth[seen],
        point_weights=weights / (weights.sum() or 1.0),
    )


def inverse_depth(ends: np.ndarray, tones: np.ndarray) -> np.ndarray:
    """Inverse depths [..., N] at tones [..., N] of maps with `ends` [..., 2]."""
    far, near = ends[..., :1], ends[..., 1:]
    return np.maximum(far + (near - far) * tones, _FLOOR * near)
