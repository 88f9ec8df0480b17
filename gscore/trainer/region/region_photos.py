"""Region photos: views of a capture that show a region, masked to its pixels."""

import math
from typing import Any

import numpy as np

from ...datasets import Dataset
from ...errors import ConfigError, DatasetError
from ...text_format import number
from .region_box import RegionBox

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
