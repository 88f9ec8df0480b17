"""Decoding of one view: photo and mask undistorted and scaled together, as bytes."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Condition

import numpy as np

from ..errors import FormatError, ShapeError
from ..io.images.read_image import (
    is_scaled,
    read_image,
    read_mask,
    reduce,
    resize,
    resize_map,
    resize_mask,
)
from ..io.images.resample import divided, premultiplied
from .undistort import Undistortion

DECODED_AT_ONCE = 1_000_000_000
"""Most bytes of photos being decoded in all threads, unless one photo alone takes more."""
_PIXEL, _PIXEL_WITH_ALPHA, _PIXEL_TO_UNDISTORT = 8, 5, 4
"""Bytes per pixel of the photo: four in Pillow, three in the array, and temporaries."""

_NO_TRACE = 1.9
"""Ratio to the final size from which the kind of interpolation no longer shows after downscaling;
nominally 2, but sizes are rounded."""


@dataclass(frozen=True, kw_only=True)
class ViewFile:
    """Files and settings to decode one view."""

    image: Path
    """The photo."""
    mask: Path | None
    """Mask file, of the photo's size or a larger size of the same aspect ratio."""
    mask_inverted: bool
    """True if white in the mask file marks pixels to ignore."""
    use_alpha: bool
    """True if the photo's alpha is the mask."""
    upright: bool
    """Apply the photo's EXIF orientation."""
    photo_size: tuple[int, int]
    """Width and height of the photo after that, pixels."""
    size: tuple[int, int]
    """Width and height of the result, pixels."""
    plan: Undistortion | None
    """Undistortion; None: the photo is from a pinhole camera."""

    @property
    def nbytes(self) -> int:
        """Bytes of the decoded view; fewer if its alpha turns out opaque."""
        channels = 4 if self.use_alpha or self.mask is not None else 3
        return self.size[0] * self.size[1] * channels

    @property
    def decoding_bytes(self) -> int:
        """Most bytes that `decode_view` takes, without its result."""
        with_alpha = self.use_alpha or self.mask is not None
        each = _PIXEL + (_PIXEL_WITH_ALPHA if with_alpha else 0)
        if self.plan is not None:
            factor = _factor(_undistorted_size(self, self.plan), self.size)
            each += _PIXEL_TO_UNDISTORT / factor**2
        return round(self.photo_size[0] * self.photo_size[1] * each)


class _Room:
    """Memory budget shared by several threads: `take` waits until enough is free. A request larger
    than the budget gets all of it, alone."""

    def __init__(self, size: int) -> None:
        self._size, self._taken = size, 0
        self._changed = Condition()

    @contextmanager
    def take(self, size: int) -> Iterator[None]:
        """Reserve `size` bytes within the block."""
        with self._changed:
            self._changed.wait_for(lambda: not self._taken or self._taken + size <= self._size)
            self._taken += size
        try:
            yield
        finally:
            with self._changed:
                self._taken -= size
                self._changed.notify_all()


_ROOM = _Room(DECODED_AT_ONCE)


def decode_view(file: ViewFile) -> tuple[np.ndarray, np.ndarray | None]:
    """Decode, undistort and scale one view; thread-safe. Photos decoded at the same time take at
    most `DECODED_AT_ONCE` bytes together.

    Returns:
        [H, W, 3] uint8 photo and [H, W] uint8 mask (255 = keep) or None, both contiguous.

    Raises:
        DatasetError: a file is missing.
        FormatError: a file is corrupt, or its size has changed.
    """
    with _ROOM.take(file.decoding_bytes):
        return _decode(file)


def _decode(file: ViewFile) -> tuple[np.ndarray, np.ndarray | None]:
    photo = read_image(file.image, upright=file.upright)
    _check_size(file, file.image, photo)
    mask = None
    if file.use_alpha and photo.shape[2] == 4:
        if photo[..., 3].min() == 255:
            photo = photo[..., :3]
        else:
            rgba = _fit_rgba(file, photo)
            return np.ascontiguousarray(rgba[..., :3]), np.ascontiguousarray(rgba[..., 3])
    if file.mask is not None:
        mask = read_mask(file.mask, inverted=file.mask_inverted)
        if is_scaled((mask.shape[1], mask.shape[0]), file.photo_size):
            mask = resize_mask(mask, *file.photo_size)
        _check_size(file, file.mask, mask)
        # A binary mask stays binary: interpolation would invent half-transparent rims.
        mask = _fit(file, mask, nearest=not np.any((mask > 0) & (mask < 255)))
    return _fit(file, np.ascontiguousarray(photo[..., :3])), mask


def fit_map(file: ViewFile, values: np.ndarray) -> np.ndarray:
    """Undistort and scale a map of numbers, such as depth, together with its photo.

    Args:
        file: The view.
        values: [h, w] float32 of any size that covers the whole photo; NaN: unknown.

    Returns:
        [H, W] float32 at the size of the decoded photo; NaN: unknown.

    Raises:
        ShapeError: the map has another aspect ratio than the photo.
    """
    check_proportions(file, values)
    if file.plan is not None:
        height, width = values.shape
        pixels = (width / file.plan.camera.width, height / file.plan.camera.height)
        full = (
            max(file.size[0], round(file.plan.width * pixels[0])),
            max(file.size[1], round(file.plan.height * pixels[1])),
        )
        values = file.plan.remap(values, full, pixels=pixels)
    return resize_map(values, *file.size)


def check_proportions(file: ViewFile, values: np.ndarray) -> None:
    """Raise ShapeError if a map [h, w] has another aspect ratio than the photo."""
    height, width = values.shape
    photo_width, photo_height = file.photo_size
    # Networks and exporters round sizes: a difference of a pixel and 1 % is not a crop.
    expected = photo_height * width / photo_width
    if abs(expected - height) > 1 + 0.01 * height:
        raise ShapeError(
            f"it is {width} x {height} pixels, which does not have the proportions of the photo, "
            f"{photo_width} x {photo_height}"
        )


def _check_size(file: ViewFile, path: Path, image: np.ndarray) -> None:
    height, width = image.shape[:2]
    if (width, height) != file.photo_size:
        expected = f"{file.photo_size[0]} x {file.photo_size[1]}"
        raise FormatError(
            f"{path} is {width} x {height} pixels, expected {expected}; it changed while the "
            f"capture was being read. Start again."
        )


def _fit(
    file: ViewFile, image: np.ndarray, *, nearest: bool = False, sharp: bool = True
) -> np.ndarray:
    """Undistort and scale [h, w, ...] uint8 to the final size; `sharp` applies only where it
    shows."""
    if file.plan is not None:
        width, height = file.photo_size
        pixels = (width / file.plan.camera.width, height / file.plan.camera.height)
        full = _undistorted_size(file, file.plan)
        factor = _factor(full, file.size)
        size = (
            max(file.size[0], round(full[0] / factor)),
            max(file.size[1], round(full[1] / factor)),
        )
        image = file.plan.remap(
            reduce(image, factor),
            size,
            pixels=(pixels[0] / factor, pixels[1] / factor),
            nearest=nearest,
            sharp=sharp and min(size[0] / file.size[0], size[1] / file.size[1]) < _NO_TRACE,
        )
    return resize(image, *file.size)


def _undistorted_size(file: ViewFile, plan: Undistortion) -> tuple[float, float]:
    """Width and height of the undistorted photo, in pixels of the photo's scale."""
    width, height = file.photo_size
    return plan.width * (width / plan.camera.width), plan.height * (height / plan.camera.height)


def _factor(full: tuple[float, float], size: tuple[int, int]) -> int:
    """Factor by which a photo is reduced before it is undistorted to `full` and scaled to `size`.

    Large photos are first averaged by an integer factor to at least twice the final size, because
    that is many times cheaper than interpolating all of their pixels.
    """
    ratio = min(full[0] / size[0], full[1] / size[1])
    return max(1, int(ratio / 2 + 0.05))  # 0.05: sizes are rounded


def _fit_rgba(file: ViewFile, image: np.ndarray) -> np.ndarray:
    """`_fit` for RGBA: averages premultiplied colours, so that hidden colours do not bleed in."""
    if file.plan is None:
        return resize(image, *file.size)  # weights by alpha itself
    # Colours and alpha separately, because Pillow would weight four channels by alpha once more.
    # Not sharp: where alpha overshoots 255 and premultiplied colours do not, rims turn bright.
    colors = _fit(file, premultiplied(image), sharp=False)
    return divided(colors, _fit(file, np.ascontiguousarray(image[..., 3]), sharp=False))
