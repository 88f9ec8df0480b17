"""Image reader: decoding to bytes, size without decoding, downscaling, PNG output."""

import struct
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import ShapeError
from ..files import atomic_write
from .image_header import ORIENTATION, ImageInfo, read_header
from .pillow_images import check_pixels, loaded, opened_picture, pillow
from .pixels import has_alpha, mask_bytes, photo_bytes
from .raw import is_raw, raw_info

IMAGE_ENDINGS = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp", ".tga")
"""Endings tried where a name has none or names a file of another kind, lower case."""


def read_info(path: str | Path) -> ImageInfo:
    """Size and kind of an image, without decoding it.

    PNG and JPEG take the standard library alone, other kinds take Pillow.

    Raises:
        DatasetError: the file is missing or no regular one.
        FormatError: it is no image, or too large to be read.
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
        path: The file, of `pillow.PICTURE_FORMATS`. Grey, palette, CMYK and 16-bit images are
            converted, floats from 0 to 1 too; of several pictures in a file the first is taken.
        upright: Turn it as EXIF asks. COLMAP does not, so neither does gscore by default.

    Returns:
        [H, W, 3] uint8 sRGB, or [H, W, 4] if the file has transparency (not premultiplied).

    Raises:
        DatasetError: the file is missing or no regular one.
        FormatError: it is no image, truncated, corrupt or too large, or which of its numbers is
            white is not known.
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
        path: Grey, black and white, or colour image; one whose transparency varies gives that.
        inverted: Its white marks what to leave out.

    Returns:
        [H, W] uint8, 255 = keep. Masks that hold only 0 and one other number are stretched to 0
        and 255.

    Raises:
        As `read_image`.
    """
    mask = _mask(Path(path))[0]
    return 255 - mask if inverted else mask


def assumed_of_mask(path: str | Path) -> str:
    """What `read_mask` takes for white in a mask where that is not white, as the end of a sentence
    that begins with masks; empty where nothing is assumed. Raises as `read_image`."""
    return _mask(Path(path))[1]


def resize(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """Scale an image down by averaging.

    Whole-numbered factors use the mean of the pixels each new pixel covers; others a Hamming
    window of that size, Pillow's advice for downscaling, because a box would shift edges by up to
    half a pixel. Neither rings as bicubic and Lanczos do; splats cannot follow ringing. RGBA is
    weighted by its alpha.

    Args:
        image: [H, W], [H, W, 3] or [H, W, 4] uint8.
        width: New width in pixels, not above the old one.
        height: New height in pixels, not above the old one.

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
        # Rounds once; resize with a box rounds up after each axis and brightens by half a step.
        return np.array(source.reduce((old_width // width, old_height // height)))
    return np.array(source.resize((width, height), pil.Resampling.HAMMING))


def resize_map(values: np.ndarray, width: int, height: int) -> np.ndarray:
    """Scale a map of numbers to any size, each pixel the mean of the known ones it covers.

    Args:
        values: [H, W] float32; NaN: unknown.
        width: New width in pixels.
        height: New height in pixels.

    Returns:
        [height, width] float32; NaN where less than half of a pixel is known.
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
    """Whether a picture shows all of a photo that was scaled down: it is larger by a tenth or more,
    and of the same proportions within the rounding of the photo's sides."""
    scale = size[0] / photo[0]
    return scale >= 1.1 and abs(size[1] / scale - photo[1]) <= 1


def resize_mask(mask: np.ndarray, width: int, height: int) -> np.ndarray:
    """Scale a mask [H, W] down as `resize` does; one of only 0 and 255 stays one."""
    scaled = resize(mask, width, height)
    if np.any((mask > 0) & (mask < 255)):
        return scaled
    return np.where(scaled >= 128, np.uint8(255), np.uint8(0))


def reduce(image: np.ndarray, factor: int) -> np.ndarray:
    """Mean of `factor` x `factor` blocks; the last row and column average what is left.

    Args:
        image: [H, W], [H, W, 3] or [H, W, 4] uint8.
        factor: At least 1.

    Returns:
        [ceil(H / factor), ceil(W / factor), ...] uint8; pixel i covers [i factor, (i + 1) factor).
    """
    return np.array(pillow().fromarray(image).reduce(factor)) if factor > 1 else image


SIGNED = {"Software": "gscore"}
"""Texts of a PNG that says who made it, so that another of its name may replace it unasked."""


def write_png(path: str | Path, image: np.ndarray, texts: Mapping[str, str] | None = None) -> None:
    """Write a PNG with the standard library alone, completely or not at all.

    Args:
        path: The file to write; its folder is made.
        image: [H, W], [H, W, 3] or [H, W, 4] uint8; grey, RGB or RGBA (not premultiplied), sRGB. Or
            [H, W] uint16, grey.
        texts: By keyword, ASCII both.

    Raises:
        ShapeError: another shape or dtype.
        GsError: the file cannot be written.
    """
    shape = image.shape
    kinds = {1: 0, 3: 2, 4: 6}  # colour types of the PNG standard, by number of channels
    channels = 1 if len(shape) == 2 else shape[2] if len(shape) == 3 else 0
    deep = image.dtype == np.uint16 and len(shape) == 2
    if channels not in kinds or not (deep or image.dtype == np.uint8) or 0 in shape:
        raise ShapeError(
            f"write_png takes uint8 [H, W], [H, W, 3] or [H, W, 4] or uint16 [H, W], got "
            f"{image.dtype} {list(shape)}."
        )
    height, width = shape[:2]
    size = 2 if deep else channels  # bytes of a pixel, the high one of 16 bits first
    pixels = np.ascontiguousarray(image, ">u2" if deep else None).view(np.uint8)
    pixels = pixels.reshape(height, width, size)
    rows = np.zeros((height, width * size + 1), np.uint8)
    rows[:, 0] = 1  # filter "Sub": each byte minus the one of the pixel to the left
    rows[:, 1 : 1 + size] = pixels[:, 0]
    rows[:, 1 + size :] = (pixels[:, 1:] - pixels[:, :-1]).reshape(height, -1)
    head = struct.pack(">IIBBBBB", width, height, 16 if deep else 8, kinds[channels], 0, 0, 0)
    words = [(b"tEXt", f"{key}\0{text}".encode("ascii")) for key, text in (texts or {}).items()]
    chunks = [(b"IHDR", head), *words, (b"IDAT", zlib.compress(rows.data, 6)), (b"IEND", b"")]
    out = [b"\x89PNG\r\n\x1a\n"]
    for kind, body in chunks:
        check = struct.pack(">I", zlib.crc32(kind + body))
        out += [struct.pack(">I", len(body)), kind, body, check]
    atomic_write(path, b"".join(out))


TURNS = {
    2: "FLIP_LEFT_RIGHT",
    3: "ROTATE_180",
    4: "FLIP_TOP_BOTTOM",
    5: "TRANSPOSE",
    6: "ROTATE_270",
    7: "TRANSVERSE",
    8: "ROTATE_90",
}
"""Pillow's names for what shows a picture as its EXIF orientation asks."""


def _exif_turn(image: Any) -> int:
    try:
        return image.getexif().get(ORIENTATION, 1)
    except Exception:  # damaged EXIF does not make the picture unusable
        return 1


def _mask(path: Path) -> tuple[np.ndarray, str]:
    with loaded(path) as (image, deep):
        return mask_bytes(path, image, deep=deep)
