"""The views of a capture at the size that a step of the training wants."""

from typing import NamedTuple

import numpy as np
import torch

from ..datasets.resolution import scale_intrinsics
from ..io.images import resize
from ..scene import Cameras
from .skips import tiles_of_mask
from .views import Photos, View, view_of


class Sized(NamedTuple):
    """A view with its photo at some size."""

    view: View
    image: np.ndarray
    """[H, W, 3] uint8."""
    mask: np.ndarray | None
    """[H, W] uint8, or None."""
    tiles: torch.Tensor | None
    """[ceil(H / 16), ceil(W / 16)] uint8, 0 where an `ignore` mask hides a whole tile; None where
    every tile counts."""


class Pyramid:
    """Photos scaled down on first use; those of one factor are kept at a time."""

    def __init__(self, photos: Photos, cameras: Cameras) -> None:
        """`cameras` are those of `photos` in the training world."""
        self._photos = photos
        self._cameras = cameras
        self._factor = 1.0
        self._kept: dict[int, Sized] = {}

    def at(self, index: int, factor: float) -> Sized:
        """View `index` with sides divided by `factor` >= 1, K exact for the rounded size."""
        if factor != self._factor:
            self._factor, self._kept = factor, {}
        found = self._kept.get(index)
        if found is None:
            found = self._kept[index] = self._scaled(index, factor)
        return found

    def view(self, index: int) -> View:
        """View `index` at full size."""
        cameras = self._cameras
        size = int(cameras.widths[index]), int(cameras.heights[index])
        return view_of(cameras.viewmats[index], cameras.Ks[index], *size)

    def _scaled(self, index: int, factor: float) -> Sized:
        photos, cameras = self._photos, self._cameras
        image, mask = photos.image(index), photos.mask(index)
        old = int(cameras.widths[index]), int(cameras.heights[index])
        new = max(1, round(old[0] / factor)), max(1, round(old[1] / factor))
        if new != old:
            if mask is None:
                image = resize(image, *new)
            else:  # colours that the mask hides do not bleed in
                both = resize(np.dstack([image, mask]), *new)
                image = np.ascontiguousarray(both[..., :3])
                mask = np.ascontiguousarray(both[..., 3])
        K = scale_intrinsics(cameras.Ks[index], old, new)
        tiles = None
        if mask is not None and photos.mask_mode == "ignore":
            tiles = torch.from_numpy(tiles_of_mask(mask))
        return Sized(view_of(cameras.viewmats[index], K, *new), image, mask, tiles)
