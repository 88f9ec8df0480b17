"""Stereo photos: small and grey, with cameras of that size."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..datasets import Dataset
from ..datasets.resolution import scale_intrinsics
from ..io.images.read_image import resize
from ..raster.stereo_depth import StereoView

_GREY = np.array([0.299, 0.587, 0.114], np.float32)
"""Luma of sRGB values (Rec. 601)."""
_HIDDEN = 128
"""Grey of masked pixels: no contrast, so they match nothing."""


@dataclass(frozen=True, kw_only=True)
class SmallPhoto:
    """Downscaled photo of one view."""

    index: int
    """Index in the dataset."""
    view: StereoView
    """Grey photo and camera."""
    rgb: np.ndarray
    """[H, W, 3] uint8."""
    counts: np.ndarray | None
    """[H, W] bool, unmasked pixels without the rim of the mask; None: all."""


def small_photo(dataset: Dataset, index: int, *, side: int, rim: int) -> SmallPhoto:
    """A view of the dataset, downscaled; decodes the photo if needed.

    Args:
        dataset: The capture.
        index: Index of the view.
        side: Maximum of the longer side, px.
        rim: Width of the excluded rim around masked pixels, px, because windows reach over it.
    """
    image, mask = dataset.image(index), dataset.mask(index)
    if dataset.mask_mode == "none":
        mask = None
    cameras = dataset.scene.cameras
    old = int(cameras.widths[index]), int(cameras.heights[index])
    factor = max(1.0, max(old) / side)
    new = max(1, round(old[0] / factor)), max(1, round(old[1] / factor))
    image = resize(image, *new)
    grey = (image.astype(np.float32) @ _GREY + np.float32(0.5)).astype(np.uint8)
    counts = None
    if mask is not None and mask.min() < 255:
        shown = resize(mask, *new) >= 128
        grey[~shown] = _HIDDEN
        counts = _shrunk(shown, rim)
    K = scale_intrinsics(cameras.Ks[index], old, new)
    return SmallPhoto(
        index=index,
        view=StereoView(grey, K, cameras.viewmats[index]),
        rgb=image,
        counts=counts,
    )


def _shrunk(shown: np.ndarray, rim: int) -> np.ndarray:
    """Erosion [H, W] bool by a square of radius `rim`."""
    hidden = np.pad(~shown, rim)
    for axis in (0, 1):
        size = shown.shape[axis]
        parts: Sequence[np.ndarray] = [
            np.take(hidden, range(k, k + size), axis=axis) for k in range(2 * rim + 1)
        ]
        hidden = np.logical_or.reduce(parts)
    return ~hidden
