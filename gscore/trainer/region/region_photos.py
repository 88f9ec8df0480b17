"""Region photos: the views of a capture that show a region, masked to the region's pixels."""

import math
from typing import Any

import numpy as np

from ...datasets import Dataset
from ...errors import ConfigError, DatasetError
from ...text_format import number
from .region_box import RegionBox

_COARSE = 400
"""Pixels of the longer side at which a view must show something of the box."""


class RegionPhotos(Dataset):
    """The views that may show a box. Held-out views are measured on the pixels of the box."""

    judged_by = "region"
    """Name of the measured part of a picture, for `evaluate`."""

    def __init__(
        self, whole: Dataset, box: RegionBox, *, near: float, narrow: bool = False
    ) -> None:
        """Keep the views of `whole` that may show `box`; `near` in world units. `narrow`: training
        views are masked to the box too.

        Raises:
            DatasetError: no training view shows it, or `narrow` and it contains no point.
            ConfigError: `narrow` and the capture's masks cut the subject out.
        """
        if narrow and whole.mask_mode == "composite":
            raise ConfigError(
                "The masks of this capture cut the subject out, which a region cannot narrow. Give "
                "--mask-mode ignore: then they leave pixels out of the training."
            )
        points = whole.scene.points.points
        if narrow and len(points) and not box.holds(points).any():
            raise DatasetError(
                f"None of the {number(len(points))} points of the capture lies in the region. Is "
                "it a box in the world of the capture?"
            )
        cameras: Any = whole.scene.cameras

        def seen(index: int, *, alone: bool) -> bool:
            """Whether a view may show the box; with `alone`, whether it does."""
            size = int(cameras.widths[index]), int(cameras.heights[index])
            camera = cameras.Ks[index], cameras.viewmats[index], *size
            return box.may_be_seen(*camera, near) and (not alone or _shows(box, *camera))

        super().__init__(
            scene=whole.scene,
            files=list(whole.files),
            train=[i for i in whole.train if seen(i, alone=narrow)],
            test=[i for i in whole.test if seen(i, alone=True)],
            mask_mode="ignore" if whole.mask_mode == "none" else whole.mask_mode,
            source=whole.source,
        )
        self._box = box
        self._narrowed = frozenset(self.test + self.train if narrow else self.test)
        if whole.train and not self.train:
            raise DatasetError(
                f"None of the {len(whole.train)} training photos looks at the region. Is it a box "
                "in the world of the capture?"
            )

    def mask(self, index: int) -> np.ndarray | None:
        """[H, W] uint8. Held-out and narrowed views without cut-out masks: only the pixels whose
        rays meet the box."""
        own = super().mask(index)
        if index not in self._narrowed or self.mask_mode != "ignore":
            return own
        cameras: Any = self.scene.cameras
        size = int(cameras.widths[index]), int(cameras.heights[index])
        inside = self._box.outline(cameras.Ks[index], cameras.viewmats[index], *size)
        inside = inside.astype(np.uint8) * 255
        return inside if own is None else np.minimum(own, inside)


def _shows(box: RegionBox, K: np.ndarray, viewmat: np.ndarray, width: int, height: int) -> bool:
    """Whether the ray through any coarse pixel centre meets the box."""
    shrink = min(1.0, _COARSE / max(width, height))
    coarse = np.diag([shrink, shrink, 1.0]) @ K
    size = math.ceil(width * shrink), math.ceil(height * shrink)
    return bool(box.outline(coarse, viewmat, *size).any())
