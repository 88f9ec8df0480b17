"""Photos as bytes: decoding, size without decoding, downscaling, PNG out."""

import functools
import struct
import warnings
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import DatasetError, FormatError, ShapeError
from ..extras import need
from ..shown import shown
from .files import atomic_write, check_regular
from .image_header import ImageInfo, read_header

_PIXELS_A_STRIP = 1 << 20
IMAGE_ENDINGS = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp", ".tga")
"""Endings tried where a name has none or names a file of another kind, lower case."""


def read_info(path: str | Path) -> ImageInfo:
    """Size and kind of an image, without decoding it.

    PNG and JPEG take the standard library alone, other kinds take Pillow.

    Raises:
        DatasetError: the file is missing or no regular one.
        FormatError: it is no image.
        BackendError: Pillow is needed and not installed.
    """
    if info := read_header(path):
        return info
    with _open(Path(path)) as image:
        has_alpha = image.mode in _ALPHA or "transparency" in image.info
        try:
            sideways = image.getexif().get(0x0112, 1) in (5, 6, 7, 8)
        except BROKEN:  # damaged EXIF does not make the picture unusable
            sideways = False
        return ImageInfo(image.width, image.height, has_alpha, sideways)


def read_image(path: str | Path, *, upright: bool = False) -> np.ndarray:
    """Decode an image.

    Args:
        path: The file. Grey, palette, CMYK and 16-bit images are converted.
        upright: Turn it as EXIF asks. COLMAP does not, so neither does gscore by default.

    Returns:
        [H, W, 3] uint8 sRGB, or [H, W, 4] if the file has transparency (not premultiplied).

    Raises:
        DatasetError: the file is missing or no regular one.
        FormatError: it is no image, or truncated or corrupt.
        BackendError: Pillow is not installed.
    """
    path = Path(path)
    with _open(path) as image:
        has_alpha = image.mode in _ALPHA or "transparency" in image.info
        try:
            image.load()
            if upright:
                from PIL import ImageOps

                image = ImageOps.exif_transpose(image)
            return _pixels(image, "RGBA" if has_alpha else "RGB")
        except BROKEN as error:
            raise _broken(path, error) from error


def read_mask(path: str | Path, *, inverted: bool = False) -> np.ndarray:
    """Decode a mask.

    Args:
        path: Grey, black and white, or colour image; one whose transparency varies gives that.
        inverted: Its white marks what to leave out.

    Returns:
        [H, W] uint8, 255 = keep. Masks that hold only 0 and 1 are stretched to 0 and 255.

    Raises:
        As `read_image`.
    """
    image = read_image(path)
    if image.shape[2] == 4 and image[..., 3].min() < 255:
        mask = np.ascontiguousarray(image[..., 3])
    else:
        mask = image[..., :3].max(axis=2)
    mask = mask * np.uint8(255) if mask.max(initial=0) == 1 else mask
    return 255 - mask if inverted else mask


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
    pil = _pillow()
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
    pil = _pillow()
    grows = width > values.shape[1] or height > values.shape[0]
    window = pil.Resampling.BILINEAR if grows else pil.Resampling.HAMMING
    known = np.isfinite(values)

    def scaled(part: np.ndarray) -> np.ndarray:
        return np.array(pil.fromarray(part.astype(np.float32)).resize((width, height), window))

    if known.all():
        return scaled(values)
    share, total = scaled(known), scaled(np.where(known, values, 0))
    return np.divide(total, share, out=np.full_like(total, np.nan), where=share >= 0.5)


def reduce(image: np.ndarray, factor: int) -> np.ndarray:
    """Mean of `factor` x `factor` blocks; the last row and column average what is left.

    Args:
        image: [H, W], [H, W, 3] or [H, W, 4] uint8.
        factor: At least 1.

    Returns:
        [ceil(H / factor), ceil(W / factor), ...] uint8; pixel i covers [i factor, (i + 1) factor).
    """
    return np.array(_pillow().fromarray(image).reduce(factor)) if factor > 1 else image


def write_png(path: str | Path, image: np.ndarray) -> None:
    """Write a PNG with the standard library alone, completely or not at all.

    Args:
        path: The file to write; its folder is made.
        image: [H, W], [H, W, 3] or [H, W, 4] uint8; grey, RGB or RGBA (not premultiplied), sRGB. Or
            [H, W] uint16, grey.

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
    chunks = [(b"IHDR", head), (b"IDAT", zlib.compress(rows.data, 6)), (b"IEND", b"")]
    out = [b"\x89PNG\r\n\x1a\n"]
    for kind, body in chunks:
        check = struct.pack(">I", zlib.crc32(kind + body))
        out += [struct.pack(">I", len(body)), kind, body, check]
    atomic_write(path, b"".join(out))


_ALPHA = frozenset({"RGBA", "LA", "PA", "RGBa", "La"})

BROKEN: tuple[type[Exception], ...] = (
    OSError,
    ValueError,
    SyntaxError,
    TypeError,
    KeyError,
    IndexError,
    EOFError,
    MemoryError,
    OverflowError,
    RuntimeError,
    struct.error,
    zlib.error,
)
"""What Pillow's decoders raise on damaged files; besides, once loaded, DecompressionBombError."""


@functools.cache
def _pillow() -> Any:
    """PIL.Image, loaded when first needed: the numpy-only parts of gscore do without."""
    Image = need("PIL.Image", "Reading photos")
    # From half of its limit on Pillow warns with a line of source; large photos are no mistake.
    # Once for the process, because filters for a block are not safe among threads.
    warnings.filterwarnings("ignore", category=Image.DecompressionBombWarning)
    return Image


def _open(path: Path) -> Any:
    pil = _pillow()
    check_regular(path)
    try:
        return pil.open(path)
    except FileNotFoundError as error:
        raise DatasetError(f"There is no image {path}.") from error
    except (*BROKEN, pil.DecompressionBombError) as error:
        raise _broken(path, error) from error


def _broken(path: Path, error: Exception) -> FormatError:
    reason = shown(str(error) or type(error).__name__).rstrip(".")
    return FormatError(
        f"{path} cannot be read as an image: {reason}. Copy the photo again, or remove it from the "
        f"capture."
    )


def _pixels(image: Any, mode: str) -> np.ndarray:
    """[H, W, 3 or 4] uint8 of a decoded image, strip after strip: as a whole it would be
    there three times more, in Pillow's four bytes a pixel and as bytes on their way to numpy."""
    width, height = image.size
    out = np.empty((height, width, len(mode)), np.uint8)
    rows = max(1, _PIXELS_A_STRIP // width)
    for top in range(0, height, rows):
        strip = image.crop((0, top, width, min(top + rows, height)))
        if image.mode.startswith("I"):
            out[top : top + rows] = _bytes_of_16_bit(np.asarray(strip))[..., None]
        else:
            out[top : top + rows] = np.asarray(strip.convert(mode))
    return out


def _bytes_of_16_bit(values: np.ndarray) -> np.ndarray:
    """[H, W] uint8 of 16-bit grey; Pillow's own conversion cuts everything above 255."""
    return ((np.clip(values, 0, 65535).astype(np.uint32) * 255 + 32767) // 65535).astype(np.uint8)
