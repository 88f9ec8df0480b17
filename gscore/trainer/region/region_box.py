"""Region box: an oriented box, tests of points and pixels against it, and clamping to it."""

import hashlib

import numpy as np

from ...engine.base import RowEdit
from ...scene import offset_between
from ...transforms import Similarity

_CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], np.float64)


class RegionBox:
    """An oriented box, in float64 because it may be small and far from the origin."""

    def __init__(self, matrix: np.ndarray) -> None:
        """`matrix` [4, 4] float64 maps the cube [-1, 1]^3 to the box."""
        self.matrix = matrix
        self.to_unit = np.linalg.inv(matrix)
        """[4, 4] float64, maps the box to the cube."""

    def about(self, origin: np.ndarray | None) -> "RegionBox":
        """Return the box relative to a local origin."""
        matrix = self.matrix.copy()
        matrix[:3, 3] -= offset_between(origin, None)
        return RegionBox(matrix)

    def in_training(self, similarity: Similarity) -> "RegionBox":
        """Return the box in the training frame."""
        matrix = self.matrix.copy()
        matrix[:3, 3] = similarity.points_to_training(matrix[:3, 3][None])[0]
        matrix[:3, :3] *= similarity.scale
        return RegionBox(matrix)

    def content_hash(self) -> str:
        """Short hash of the box."""
        return hashlib.sha256(self.matrix.tobytes()).hexdigest()[:16]

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Return [N] bool: `points`, [N, 3], in the box or on its sides."""
        return np.abs(self._local(points)).max(axis=1, initial=0) <= 1

    def keep_inside(self, means: np.ndarray) -> RowEdit | None:
        """Return the edit that clamps `means` [N, 3] to the box; None: all are inside."""
        local = self._local(means)
        out = np.flatnonzero(~(np.abs(local).max(axis=1, initial=0) <= 1))
        if len(out) == 0:
            return None
        # Means that are not finite stay unchanged: `clamp_runaways` resets such splats.
        inside = np.clip(local[out], -1, 1) @ self.matrix[:3, :3].T + self.matrix[:3, 3]
        finite = np.isfinite(local[out]).all(axis=1)
        return RowEdit(rows=out[finite], values={"means": inside[finite].astype(np.float32)})

    def may_be_visible(
        self, K: np.ndarray, viewmat: np.ndarray, width: int, height: int, near: float
    ) -> bool:
        """Return whether the box may be visible: False only if all corners are beyond one side of
        the view frustum.

        Args:
            K: [3, 3], px.
            viewmat: [4, 4], world to camera.
            width: px.
            height: px.
            near: Near plane, world units.
        """
        corners = _CORNERS @ self.matrix[:3, :3].T + self.matrix[:3, 3]
        local = corners @ viewmat[:3, :3].T + viewmat[:3, 3]
        z = local[:, 2]
        x, y = (local @ K[:2].T).T  # times z, to avoid a division
        beyond = (z <= near, x < 0, x > width * z, y < 0, y > height * z)
        return not any(side.all() for side in beyond)

    def outline(self, K: np.ndarray, viewmat: np.ndarray, width: int, height: int) -> np.ndarray:
        """Return [H, W] bool: pixels whose rays meet the box in front of the camera.

        Args: as for `may_be_visible`.
        """
        rays = np.linalg.inv(K)
        turned = self.to_unit[:3, :3] @ viewmat[:3, :3].T
        origin = self.to_unit[:3, :3] @ (-viewmat[:3, :3].T @ viewmat[:3, 3]) + self.to_unit[:3, 3]
        across = (turned @ rays[:, 0])[:, None] * (np.arange(width) + 0.5)
        down = (turned @ rays[:, 1])[:, None] * (np.arange(height) + 0.5)
        ahead = turned @ rays[:, 2]
        first, last = np.zeros((height, width)), np.full((height, width), np.inf)
        for axis in range(3):
            along = across[axis][None, :] + (down[axis] + ahead[axis])[:, None]
            # A ray parallel to a slab and outside of it gives NaN.
            with np.errstate(divide="ignore", invalid="ignore"):
                one, other = (-1 - origin[axis]) / along, (1 - origin[axis]) / along
            np.maximum(first, np.fmin(one, other), out=first)
            np.minimum(last, np.fmax(one, other), out=last)
        return first <= last

    def _local(self, points: np.ndarray) -> np.ndarray:
        return points @ self.to_unit[:3, :3].T + self.to_unit[:3, 3]
