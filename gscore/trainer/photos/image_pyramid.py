"""Image pyramid: the views of a capture at the resolution of a training step."""

import zlib
from collections.abc import Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from typing import NamedTuple

import numpy as np

from ...datasets.resolution import divided_size, scale_intrinsics
from ...engine.base import StepPhoto
from ...io.images.read_image import resize
from ...metrics.machine import cores
from ...raster import native_library
from ...raster.request import Frustum
from ...scene import Cameras
from .view_sampler import Photos, training_camera

AHEAD, _WORKERS = 16, 8
"""Most views that are prefetched, and threads for that: a card takes a step in a fraction of the
time in which a photo is scaled."""
_FEW_AHEAD, _FEW_WORKERS = 3, 2
"""The same with a memory limit, because each photo is decoded there."""


class SizedView(NamedTuple):
    """A view with its photo at one size."""

    view: Frustum
    image: np.ndarray
    """[H, W, 3] uint8."""
    mask: np.ndarray | None
    """[H, W] uint8, or None."""
    tiles: np.ndarray | None
    """[ceil(H / 16), ceil(W / 16)] uint8, 0 for tiles that an `ignore` mask hides completely; None:
    all tiles are used."""
    counted: float = 1.0
    """Share of unmasked pixels: less than 1 only with an `ignore` mask."""
    version: int = 0
    """Above 0: the mask, which says which pixels count, was made in training, and is another for
    another number; 0: it is that of the capture."""

    def photo(self, mask_mode: str, *, masked_tiles: bool = False) -> StepPhoto:
        """The photo for an engine; `masked_tiles`: draw tiles that masks hide, too."""
        tiles = None if masked_tiles else self.tiles
        return StepPhoto(
            image=self.image,
            mask=self.mask,
            mask_mode="ignore" if self.version else mask_mode,
            tiles=tiles,
            counted=self.counted,
            version=self.version,
        )

    def masked(self, mask: np.ndarray) -> "SizedView":
        """The same view without the pixels that are 0 in a mask [H, W] uint8, too."""
        if self.mask is not None:
            mask = np.minimum(mask, self.mask)
        return self._replace(
            mask=mask,
            tiles=tiles_of_mask(mask),
            counted=float(mask.mean()) / 255,
            version=zlib.crc32(np.ascontiguousarray(mask).data) or 1,
        )


class ImagePyramid:
    """Photos scaled down on first use, kept for one factor at a time.

    The next ones are prefetched in the background. With a memory limit the first photos are kept,
    which is optimal if each is used once per epoch. The pixels depend on neither.
    """

    def __init__(
        self,
        photos: Photos,
        cameras: Cameras,
        *,
        near: float,
        limit: int | None = None,
        threads: int = 0,
    ) -> None:
        """Create an empty pyramid.

        Args:
            photos: The capture.
            cameras: Cameras of `photos` in the training frame.
            near: Near plane, training units.
            limit: Bytes of photos to keep; None: all.
            threads: Most threads that prefetch; 0: all cores.
        """
        self._photos = photos
        self._cameras = cameras
        self._near = near
        self._limit = limit
        self._factor = 1.0
        self._kept: dict[int, SizedView] = {}
        self._nbytes = 0
        self._coming: dict[int, Future[SizedView]] = {}
        self._ahead, workers = AHEAD, min(threads or cores(), _WORKERS)
        if limit is not None:
            self._ahead, workers = _FEW_AHEAD, _FEW_WORKERS
        self._pool = ThreadPoolExecutor(workers, "gscore-photos")

    def at(self, index: int, factor: float, *, upcoming: Iterable[int] = ()) -> SizedView:
        """Return view `index` with sides divided by `factor` >= 1, K exact for the rounded size.

        `upcoming`: the next views, for prefetching; only read where photos are missing.
        """
        if factor != self._factor:
            self._factor, self._kept, self._nbytes = factor, {}, 0
            for future in self._coming.values():
                future.cancel()
            self._coming = {}
        found = self._kept.get(index)
        if found is not None and self._limit is None:
            return found
        for i in (index, *islice(upcoming, self._ahead)):
            if i not in self._kept and i not in self._coming:
                self._coming[i] = self._pool.submit(self._scaled, i, factor)
        if found is None:
            found = self._coming.pop(index).result()
            self._keep(index, found)
        return found

    def _keep(self, index: int, found: SizedView) -> None:
        nbytes = found.image.nbytes + (0 if found.mask is None else found.mask.nbytes)
        if self._limit is None or self._nbytes + nbytes <= self._limit:
            self._kept[index] = found
            self._nbytes += nbytes

    @property
    def keeps_all(self) -> bool:
        """True without a memory limit."""
        return self._limit is None

    def view(self, index: int, factor: float = 1.0) -> Frustum:
        """Return the camera of view `index` with sides divided by `factor` >= 1, K exact for the
        rounded size."""
        cameras = self._cameras
        old = int(cameras.widths[index]), int(cameras.heights[index])
        new = divided_size(*old, factor)
        K = scale_intrinsics(cameras.Ks[index], old, new) if new != old else cameras.Ks[index]
        return training_camera(cameras.viewmats[index], K, *new, self._near)

    def _scaled(self, index: int, factor: float) -> SizedView:
        photos = self._photos
        image, mask = photos.image(index), photos.mask(index)
        view = self.view(index, factor)
        new = view.width, view.height
        if new != (image.shape[1], image.shape[0]):
            if mask is None:
                image = resize(image, *new)
            else:  # weight by the mask, so that masked colours do not bleed in
                both = resize(np.dstack([image, mask]), *new)
                image = np.ascontiguousarray(both[..., :3])
                mask = np.ascontiguousarray(both[..., 3])
        tiles, counted = None, 1.0
        if mask is not None and photos.mask_mode == "ignore":
            tiles = tiles_of_mask(mask)
            counted = float(mask.mean()) / 255
        return SizedView(view, image, mask, tiles, counted)


def tiles_of_mask(mask: np.ndarray) -> np.ndarray:
    """Return [ceil(H / 16), ceil(W / 16)] uint8, 1 for tiles with a non-zero pixel of `mask`, which
    is [H, W] uint8."""
    tile = native_library.TILE
    height, width = mask.shape
    rows, columns = -(-height // tile), -(-width // tile)
    padded = np.zeros((rows * tile, columns * tile), bool)
    padded[:height, :width] = mask > 0
    blocks = padded.reshape(rows, tile, columns, tile)
    return np.asarray(blocks.any(axis=(1, 3)), np.uint8)
