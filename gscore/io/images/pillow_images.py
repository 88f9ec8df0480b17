"""Pillow images: opened with checks of format, size and completeness."""

import functools
import io
import logging
import re
import struct
import threading
import warnings
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from ...errors import DatasetError, FormatError, GsError
from ...extras import need
from ...text_format import count_text, number
from ..files import check_regular, open_regular
from ..system_memory import available_memory_bytes, total_memory_bytes
from .image_header import ORIENTATION, read_header
from .raw import full_size_page, is_raw, raw_info, read_raw
from .truncated_images import truncation_reason, with_end_marker

PICTURE_FORMATS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP", "TGA", "PPM")
"""Supported formats, by Pillow's names. Every picture is opened with this list, because Pillow
detects the format by content and would start Ghostscript for EPS."""
MOST_PIXELS = 178_956_970
"""Most pixels of a picture that is read whatever its file's size, the limit of Pillow. Larger ones
are read where their file is large enough for them and they fit into memory."""
_PIXELS_A_BYTE = 60
"""Most pixels per byte of the file of a larger picture: photos have 1 to 30, decompression bombs
hundreds."""
_NEEDED = 13
"""Bytes per pixel that such a picture takes while it is decoded: four of Pillow, up to four of the
array and five to convert it."""

BROKEN: tuple[type[Exception], ...] = (
    OSError,
    ValueError,
    SyntaxError,
    TypeError,
    KeyError,
    IndexError,
    EOFError,
    OverflowError,
    RuntimeError,
    struct.error,
    zlib.error,
)
"""Errors of Pillow's decoders on damaged files."""
_JPEG, _JPEG_END = b"\xff\xd8\xff", b"\xff\xd9"
_STATED = re.compile(r"\((\d+) pixels\)")
_UNLIMITED = threading.RLock()
_log = logging.getLogger(__name__)


@functools.cache
def pillow() -> Any:
    """PIL.Image, imported on first use, because the numpy-only parts of gscore do not need it.

    Raises:
        BackendError: Pillow is not installed.
    """
    Image = need("PIL.Image", "Reading photos")
    # Above half of its limit Pillow warns, but large photos are not a mistake. The filter is set
    # once for the process, because filters of a block are not thread-safe.
    warnings.filterwarnings("ignore", category=Image.DecompressionBombWarning)
    return Image


@contextmanager
def opened_picture(path: Path) -> Iterator[Any]:
    """Open a picture as PIL.Image.Image with its header read; `load` reads its pixels.

    Errors of the picture inside the block also become one of the errors below.

    Raises:
        DatasetError: the file is missing or no regular file.
        FormatError: it is not a picture of a supported format, damaged, or too large.
        BackendError: Pillow is not installed.
    """
    pil = pillow()
    check_regular(path)
    if is_raw(path):
        yield _developed(path)
        return
    if info := read_header(path):  # has width and height; Pillow's error only their product
        check_pixels(path, info.width, info.height)
    try:
        with ExitStack() as stack:
            image = stack.enter_context(_opened(path))
            if image.format == "TIFF":
                image.seek(full_size_page(path))
            check_pixels(path, image.width, image.height)
            if image.width * image.height > MOST_PIXELS:
                stack.enter_context(_without_limit())
            yield image
    except GsError:  # some are ValueErrors and RuntimeErrors too
        raise
    except FileNotFoundError as error:
        raise DatasetError(f"There is no image {path}.") from error
    except pil.UnidentifiedImageError as error:
        raise _broken(
            path,
            "its format is not supported (PNG, JPEG, WebP, TIFF with 8 or 16 bits or grey floats, "
            "BMP, TGA and PPM are), or its first bytes are damaged",
        ) from error
    except MemoryError as error:
        raise FormatError(
            f"{path} does not fit into memory. Close programs, or scale the pictures down."
        ) from error
    except BROKEN as error:
        raise _broken(path, (str(error) or type(error).__name__).rstrip(".")) from error


def _opened(path: Path) -> Any:
    """A picture of which the header is read, of any size that `check_pixels` allows."""
    pil = pillow()
    try:
        return pil.open(_source(path), formats=PICTURE_FORMATS)
    except pil.DecompressionBombError as error:
        stated = _STATED.search(str(error))
        if stated is None:
            raise
        _check_count(path, int(stated[1]), count_text(int(stated[1]), "pixel"))
    with _without_limit():
        return pil.open(_source(path), formats=PICTURE_FORMATS)


@contextmanager
def _without_limit() -> Iterator[None]:
    """Pillow without its limit, which is one for the process: a picture at a time."""
    pil = pillow()
    with _UNLIMITED:
        limit, pil.MAX_IMAGE_PIXELS = pil.MAX_IMAGE_PIXELS, None
        try:
            yield
        finally:
            pil.MAX_IMAGE_PIXELS = limit


def _source(path: Path) -> Path | io.BytesIO:
    """Source for Pillow: the file, or, for a JPEG that lacks only its end marker, its bytes with
    the marker, because Pillow refuses a JPEG without it."""
    with open_regular(path) as file:
        if file.read(3) != _JPEG:
            return path
        file.seek(-2, io.SEEK_END)
        if file.read() == _JPEG_END:
            return path
    raw = with_end_marker(path)
    if raw is None:
        return path
    _warn_of_lost_end(path)
    return io.BytesIO(raw)


@functools.cache
def _warn_of_lost_end(path: Path) -> None:
    """Warn once per file, because files are decoded several times."""
    _log.warning("The last bytes of %s are missing, but all of its pixels are there.", path)


@contextmanager
def loaded(path: Path) -> Iterator[tuple[Any, bool]]:
    """A picture with its pixels loaded, and whether its file has 16 bits per channel, of which
    Pillow keeps 8 for colours.

    Raises:
        DatasetError, FormatError, BackendError: as `opened_picture`, or pixels are missing.
    """
    with opened_picture(path) as image:
        deep = any(";16" in str(tile[3]) for tile in getattr(image, "tile", ()))
        load_complete(path, image)
        yield image, deep


def _developed(path: Path) -> Any:
    """A developed raw photo as PIL.Image.Image, with the EXIF orientation of its file."""
    info = raw_info(path)
    check_pixels(path, info.width, info.height)
    rgb, turn = read_raw(path)
    image = pillow().fromarray(rgb)
    image.getexif()[ORIENTATION] = turn
    return image


def load_complete(path: Path, image: Any) -> None:
    """Load the pixels of an opened picture; raise FormatError if some are missing."""
    image.load()
    if reason := truncation_reason(path, image):
        raise _broken(path, reason)


def check_pixels(path: Path, width: int, height: int) -> None:
    """Raise FormatError for a picture of more than `MOST_PIXELS` whose file is too small for them,
    or that does not fit into memory."""
    _check_count(path, width * height, f"{width} x {height} pixels")


def _check_count(path: Path, pixels: int, stated: str) -> None:
    if pixels <= MOST_PIXELS:
        return
    size = path.stat().st_size
    if pixels > _PIXELS_A_BYTE * size:
        raise FormatError(
            f"{path} states a size of {stated} in {number(size)} bytes: pictures of more than "
            f"{number(MOST_PIXELS)} pixels are read only from files that are large enough for a "
            "photo. Scale the picture down, or copy it again if it is damaged."
        )
    free = available_memory_bytes()
    free = (total_memory_bytes() or 0) // 2 if free is None else free
    if _NEEDED * pixels > free:
        raise FormatError(
            f"{path} has {stated}, for which {_NEEDED * pixels / 1e9:.1f} GB of memory are needed, "
            f"but {free / 1e9:.1f} GB are free. Close programs, or scale the pictures down."
        )


def _broken(path: Path, reason: str) -> FormatError:
    return FormatError(
        f"{path} cannot be read as an image: {reason}. Copy the file again, or remove it from the "
        f"capture."
    )
