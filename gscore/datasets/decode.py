"""One view decoded: photo and mask undistorted and scaled together, as bytes."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import FormatError, ShapeError
from ..io.images import read_image, read_mask, reduce, resize, resize_map
from .undistort import Undistortion


@dataclass(frozen=True, kw_only=True)
class ViewFile:
    """Everything needed to decode one view."""

    image: Path
    """The photo."""
    mask: Path | None
    """Its mask file, of the photo's size."""
    mask_inverted: bool
    """Whether the white of the mask file marks what to leave out."""
    use_alpha: bool
    """Whether the photo's alpha is the mask."""
    upright: bool
    """Whether to turn the photo as EXIF asks."""
    photo_size: tuple[int, int]
    """Width and height of the photo, after turning, pixels."""
    size: tuple[int, int]
    """Width and height to deliver, pixels."""
    plan: Undistortion | None
    """How to undistort; None: the photo is one of a pinhole camera."""

    @property
    def nbytes(self) -> int:
        """Bytes of the decoded view; fewer if its alpha turns out opaque."""
        channels = 4 if self.use_alpha or self.mask is not None else 3
        return self.size[0] * self.size[1] * channels


def decode_view(file: ViewFile) -> tuple[np.ndarray, np.ndarray | None]:
    """Decode, undistort and scale one view.

    Returns:
        [H, W, 3] uint8 photo and [H, W] uint8 mask (255 = keep) or None, both contiguous.

    Raises:
        DatasetError: a file is missing.
        FormatError: a file is corrupt, or its size is no longer what it was.
    """
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
        _check_size(file, file.mask, mask)
        # A mask of only yes and no stays one: half-transparent rims would be invented otherwise.
        mask = _fit(file, mask, nearest=not np.any((mask > 0) & (mask < 255)))
    return _fit(file, np.ascontiguousarray(photo[..., :3])), mask


def fit_map(file: ViewFile, values: np.ndarray) -> np.ndarray:
    """Undistort and scale a map of numbers, such as depth, together with its photo.

    Args:
        file: The view.
        values: [h, w] float32 of any size, showing what the photo shows; NaN: unknown.

    Returns:
        [H, W] float32 at the size of the decoded photo; NaN: unknown.

    Raises:
        ShapeError: the map has other proportions than the photo.
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
    """Raise ShapeError if a map [h, w] cannot show the whole photo, whatever its resolution."""
    height, width = values.shape
    photo_width, photo_height = file.photo_size
    # Networks and exporters round sizes; a pixel of the map and 1 % are not a crop.
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


def _fit(file: ViewFile, image: np.ndarray, *, nearest: bool = False) -> np.ndarray:
    """Undistort and scale [h, w, ...] uint8 to the size to deliver."""
    if file.plan is not None:
        width, height = file.photo_size
        pixels = (width / file.plan.camera.width, height / file.plan.camera.height)
        full = (file.plan.width * pixels[0], file.plan.height * pixels[1])
        # Interpolation at twice the final size leaves no trace after scaling down, so large photos
        # are first averaged by whole factors, many times cheaper. 0.05: sizes are rounded.
        ratio = min(full[0] / file.size[0], full[1] / file.size[1])
        factor = max(1, int(ratio / 2 + 0.05))
        size = (
            max(file.size[0], round(full[0] / factor)),
            max(file.size[1], round(full[1] / factor)),
        )
        image = file.plan.remap(
            reduce(image, factor),
            size,
            pixels=(pixels[0] / factor, pixels[1] / factor),
            nearest=nearest,
        )
    return resize(image, *file.size)


def _fit_rgba(file: ViewFile, image: np.ndarray) -> np.ndarray:
    """`_fit` for colours with alpha: averaged premultiplied, so hidden colours do not bleed in."""
    if file.plan is None:
        return resize(image, *file.size)  # weighs by alpha itself
    alpha = image[..., 3:].astype(np.uint16)
    rgb = ((image[..., :3] * alpha + 127) // 255).astype(np.uint8)
    # Apart, because Pillow would weigh the colours of a four-channel image by alpha once more.
    rgb = _fit(file, rgb).astype(np.uint16)
    fitted = _fit(file, np.ascontiguousarray(image[..., 3]))
    weight = np.maximum(fitted, 1).astype(np.uint16)[..., None]
    rgb = np.minimum((rgb * 255 + weight // 2) // weight, 255).astype(np.uint8)
    return np.dstack([rgb, fitted])
