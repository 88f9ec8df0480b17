"""Region: an oriented box, and the views of a capture that show it, masked to its pixels."""

import hashlib
import math
from typing import Any

import numpy as np

from ...datasets import Dataset
from ...engine.base import RowEdit
from ...errors import ConfigError, DatasetError
from ...scene import offset_between
from ...text_format import number
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


_COARSE = 400
"""Longer side at which a view is checked for pixels of the box, px."""


class RegionPhotos(Dataset):
    """Views that may show a box. Held-out views are evaluated on the pixels of the box."""

    evaluated_part = "region"
    """Name of the evaluated part of a photo, for `evaluate`."""

    def __init__(
        self, whole: Dataset, box: RegionBox, *, near: float, narrow: bool = False
    ) -> None:
        """Select the views of `whole` that may show `box`.

        Args:
            whole: The capture.
            box: Region box, COLMAP world.
            near: Near plane, world units.
            narrow: Whether training views are masked to the box too.

        Raises:
            DatasetError: no training view shows the box, or `narrow` and it contains no point.
            ConfigError: `narrow` and the capture has `composite` masks.
        """
        if narrow and whole.mask_mode == "composite":
            raise ConfigError(
                "Composite masks cannot be combined with a region without start splats. Use "
                "`--mask-mode ignore`, which excludes masked pixels from the training."
            )
        points = whole.scene.points.points
        if narrow and len(points) and not box.contains(points).any():
            raise DatasetError(
                f"None of the {number(len(points))} points of the capture is in the region. Check "
                "that the box is in the capture's world."
            )
        cameras: Any = whole.scene.cameras

        def shows(index: int, *, exact: bool) -> bool:
            """Return whether a view may show the box; with `exact`, whether it does."""
            size = int(cameras.widths[index]), int(cameras.heights[index])
            camera = cameras.Ks[index], cameras.viewmats[index], *size
            return box.may_be_visible(*camera, near) and (not exact or _has_pixels(box, *camera))

        super().__init__(
            scene=whole.scene,
            files=list(whole.files),
            train=[i for i in whole.train if shows(i, exact=narrow)],
            test=[i for i in whole.test if shows(i, exact=True)],
            mask_mode="ignore" if whole.mask_mode == "none" else whole.mask_mode,
            source=whole.source,
        )
        self._box = box
        self._narrowed = frozenset(self.test + self.train if narrow else self.test)
        if whole.train and not self.train:
            raise DatasetError(
                f"None of the {len(whole.train)} training photos shows the region. Check that the "
                "box is in the capture's world."
            )

    def mask(self, index: int) -> np.ndarray | None:
        """Mask of a view, [H, W] uint8. For held-out and narrowed views without composite masks:
        restricted to pixels whose rays meet the box."""
        own = super().mask(index)
        if index not in self._narrowed or self.mask_mode != "ignore":
            return own
        cameras: Any = self.scene.cameras
        size = int(cameras.widths[index]), int(cameras.heights[index])
        inside = self._box.outline(cameras.Ks[index], cameras.viewmats[index], *size)
        inside = inside.astype(np.uint8) * 255
        return inside if own is None else np.minimum(own, inside)


def _has_pixels(
    box: RegionBox, K: np.ndarray, viewmat: np.ndarray, width: int, height: int
) -> bool:
    """Return whether the ray through any pixel of the downscaled view meets the box."""
    shrink = min(1.0, _COARSE / max(width, height))
    coarse = np.diag([shrink, shrink, 1.0]) @ K
    size = math.ceil(width * shrink), math.ceil(height * shrink)
    return bool(box.outline(coarse, viewmat, *size).any())
