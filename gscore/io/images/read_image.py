"""Image reader: decoding to bytes, size without decoding, downscaling."""

from pathlib import Path
from typing import Any

import numpy as np

from ...errors import ShapeError
from .image_header import ORIENTATION, ImageInfo, read_header
from .pillow_images import check_pixels, loaded, opened_picture, pillow
from .pixels import has_alpha, mask_bytes, photo_bytes
from .raw import is_raw, raw_info

IMAGE_ENDINGS = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp", ".tga")
"""Endings tried if a name has none or that of another kind of file, lower case."""

_SLOWNESS = {".png": 3.0, ".webp": 2.0}
"""Time to decode and reduce a pixel relative to JPEG, by ending; measured on photos of 800 x 600 px
(17 ns of JPEG, 41 to 46 of PNG, 25 to 34 of WebP)."""


def decoding_pixels(path: Path, size: tuple[int, int]) -> int:
    """The number of JPEG pixels that take as long to decode as an image.

    Args:
        path: The file, whose ending counts.
        size: Its width and height, pixels.
    """
    return round(size[0] * size[1] * _SLOWNESS.get(path.suffix.lower(), 1.0))


def read_info(path: str | Path) -> ImageInfo:
    """Size, transparency and orientation of an image, without decoding it.

    PNG and JPEG need only the standard library, other formats need Pillow.

    Raises:
        DatasetError: the file is missing or no regular file.
        FormatError: it is not an image, or too large.
        BackendError: Pillow is needed and not installed.
    """
    path = Path(path)
    if info := read_header(path):
        check_pixels(path, info.width, info.height)
        return info
    if is_raw(path):
        info = raw_info(path)
        check_pixels(path, info.width, info.height)
        return info
    with opened_picture(path) as image:
        turn = _exif_turn(image)
        return ImageInfo(image.width, image.height, has_alpha(image), turn if turn in TURNS else 1)


def read_image(path: str | Path, *, upright: bool = False) -> np.ndarray:
    """Decode an image.

    Args:
        path: The file, in one of `PICTURE_FORMATS`. Grey, palette, CMYK and 16-bit images and
            floats from 0 to 1 are converted; of several pictures in a file the first is read.
        upright: Apply the EXIF orientation. Off by default, as in COLMAP.

    Returns:
        [H, W, 3] uint8 sRGB, or [H, W, 4] if the file has transparency (not premultiplied).

    Raises:
        DatasetError: the file is missing or no regular file.
        FormatError: it is not an image, truncated, corrupt or too large, or its value of white is
            unknown.
        BackendError: Pillow is not installed.
    """
    path = Path(path)
    with loaded(path) as (image, deep):
        pixels = photo_bytes(path, image, deep=deep)
        turn = TURNS.get(_exif_turn(image)) if upright else None
    if turn is None:
        return pixels
    pil = pillow()
    return np.array(pil.fromarray(pixels).transpose(pil.Transpose[turn]))


def read_mask(path: str | Path, *, inverted: bool = False) -> np.ndarray:
    """Decode a mask.

    Args:
        path: Grey, black and white, or colour image; an alpha channel that varies is the mask.
        inverted: White marks pixels to ignore.

    Returns:
        [H, W] uint8, 255 = keep. A mask with only 0 and one other value is stretched to 0 and 255.

    Raises:
        As `read_image`.
    """
    mask = _mask(Path(path))[0]
    return 255 - mask if inverted else mask


def mask_assumption(path: str | Path) -> str:
    """Assumption of `read_mask` about the white value of a mask, as the end of a message that
    begins with "masks"; empty without one. Raises as `read_image`."""
    return _mask(Path(path))[1]


def resize(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """Downscale an image by averaging.

    Integer factors use the mean of the pixels each new pixel covers; others a Hamming window of
    that size, which Pillow recommends for downscaling, because a box would shift edges by up to
    half a pixel. Neither rings as bicubic and Lanczos do; splats cannot reproduce ringing. RGBA is
    weighted by its alpha.

    Args:
        image: [H, W], [H, W, 3] or [H, W, 4] uint8.
        width: New width in pixels, at most the old one.
        height: New height in pixels, at most the old one.

    Returns:
        [height, width, ...] uint8, contiguous.
    """
    old_height, old_width = image.shape[:2]
    if (old_width, old_height) == (width, height):
        return np.ascontiguousarray(image)
    if not (0 < width <= old_width and 0 < height <= old_height) or image.dtype != np.uint8:
        raise ShapeError(
            f"resize takes uint8 images down to at least 1 x 1, got {image.dtype} {old_width} x "
            f"{old_height} to {width} x {height}."
        )
    pil = pillow()
    source = pil.fromarray(image)
    if old_width % width == 0 and old_height % height == 0:
        # Rounds once; resize with a box rounds up after each axis, which brightens by half a step.
        return np.array(source.reduce((old_width // width, old_height // height)))
    return np.array(source.resize((width, height), pil.Resampling.HAMMING))


def resize_map(values: np.ndarray, width: int, height: int) -> np.ndarray:
    """Resize a map of numbers to any size, averaging the known values under each pixel.

    Args:
        values: [H, W] float32; NaN: unknown.
        width: New width in pixels.
        height: New height in pixels.

    Returns:
        [height, width] float32; NaN for pixels that are less than half known.
    """
    if values.shape == (height, width):
        return values
    pil = pillow()
    grows = width > values.shape[1] or height > values.shape[0]
    window = pil.Resampling.BILINEAR if grows else pil.Resampling.HAMMING
    known = np.isfinite(values)

    def scaled(part: np.ndarray) -> np.ndarray:
        return np.array(pil.fromarray(part.astype(np.float32)).resize((width, height), window))

    if known.all():
        return scaled(values)
    share, total = scaled(known), scaled(np.where(known, values, 0))
    return np.divide(total, share, out=np.full_like(total, np.nan), where=share >= 0.5)


def is_scaled(size: tuple[int, int], photo: tuple[int, int]) -> bool:
    """True if a picture can be the full-size version of a downscaled photo: larger by a tenth or
    more, with the same aspect ratio within the rounding of the photo's sides; sizes in px."""
    scale = size[0] / photo[0]
    return scale >= 1.1 and abs(size[1] / scale - photo[1]) <= 1


def resize_mask(mask: np.ndarray, width: int, height: int) -> np.ndarray:
    """Downscale a mask [H, W] as `resize` does; a mask of only 0 and 255 stays binary."""
    scaled = resize(mask, width, height)
    if np.any((mask > 0) & (mask < 255)):
        return scaled
    return np.where(scaled >= 128, np.uint8(255), np.uint8(0))


def reduce(image: np.ndarray, factor: int) -> np.ndarray:
    """Mean of `factor` x `factor` blocks; the last row and column average the remaining pixels.

    Args:
        image: [H, W], [H, W, 3] or [H, W, 4] uint8.
        factor: At least 1.

    Returns:
        [ceil(H / factor), ceil(W / factor), ...] uint8; pixel i covers [i factor, (i + 1) factor).
    """
    return np.array(pillow().fromarray(image).reduce(factor)) if factor > 1 else image


TURNS = {
    2: "FLIP_LEFT_RIGHT",
    3: "ROTATE_180",
    4: "FLIP_TOP_BOTTOM",
    5: "TRANSPOSE",
    6: "ROTATE_270",
    7: "TRANSVERSE",
    8: "ROTATE_90",
}
"""Pillow's transpose that applies each EXIF orientation."""


def _exif_turn(image: Any) -> int:
    try:
        return image.getexif().get(ORIENTATION, 1)
    except Exception:  # damaged EXIF does not make the picture unusable
        return 1


def _mask(path: Path) -> tuple[np.ndarray, str]:
    with loaded(path) as (image, deep):
        return mask_bytes(path, image, deep=deep)
