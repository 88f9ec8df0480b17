"""Pillow images: opened with checks of format, size and completeness."""

import functools
import io
import logging
import re
import struct
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from ...errors import DatasetError, FormatError, GsError
from ...extras import need
from ...text_format import count_words, number
from ..files import check_regular, open_regular
from .image_header import ORIENTATION, read_header
from .jpeg_scan import with_end_marker
from .raw import full_size_page, is_raw, raw_info, read_raw
from .truncated_images import why_cut_short

PICTURE_FORMATS = ("PNG", "JPEG", "WEBP", "TIFF", "BMP", "TGA", "PPM")
"""What is read, by Pillow's names. Pillow takes a file for what its first bytes say, whatever its
name, and opens EPS by starting Ghostscript: so no picture is opened without this list."""
MOST_PIXELS = 178_956_970
"""Pixels of the largest picture that is read; Pillow refuses what is larger."""

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
"""What Pillow's decoders raise on damaged files."""
_JPEG, _JPEG_END = b"\xff\xd8\xff", b"\xff\xd9"
_log = logging.getLogger(__name__)
_STATED = re.compile(r"\((\d+) pixels\)")


@functools.cache
def pillow() -> Any:
    """PIL.Image, loaded when first needed: the numpy-only parts of gscore do without.

    Raises:
        BackendError: Pillow is not installed.
    """
    Image = need("PIL.Image", "Reading photos")
    # From half of its limit on Pillow warns with a line of source; large photos are no mistake.
    # Once for the process, because filters for a block are not safe among threads.
    warnings.filterwarnings("ignore", category=Image.DecompressionBombWarning)
    return Image


@contextmanager
def opened_picture(path: Path) -> Iterator[Any]:
    """A picture of which the header is read, as PIL.Image.Image; its pixels come with `load`.

    What goes wrong with the picture inside the block becomes one of the errors below too.

    Raises:
        DatasetError: the file is missing or no regular one.
        FormatError: it is no picture of a known format, damaged, or too large.
        BackendError: Pillow is not installed.
    """
    pil = pillow()
    check_regular(path)
    if is_raw(path):
        yield _developed(path)
        return
    if info := read_header(path):  # tells width and height, where Pillow has but their product
        check_pixels(path, info.width, info.height)
    try:
        with pil.open(_source(path), formats=PICTURE_FORMATS) as image:
            if image.format == "TIFF":
                image.seek(full_size_page(path))
            check_pixels(path, image.width, image.height)
            yield image
    except GsError:  # some are ValueErrors and RuntimeErrors too
        raise
    except FileNotFoundError as error:
        raise DatasetError(f"There is no image {path}.") from error
    except pil.UnidentifiedImageError as error:
        raise _broken(
            path,
            "it is none of the kinds that are read (PNG, JPEG, WebP, TIFF with 8 "
            "or 16 bits or grey floats, BMP, TGA, PPM), or its first bytes are damaged",
        ) from error
    except pil.DecompressionBombError as error:
        stated = _STATED.search(str(error))
        raise too_large(path, count_words(int(stated[1]), "pixel") if stated else "more") from error
    except MemoryError as error:
        raise FormatError(
            f"{path} does not fit into memory. Close programs, or scale the pictures down."
        ) from error
    except BROKEN as error:
        raise _broken(path, (str(error) or type(error).__name__).rstrip(".")) from error


def _source(path: Path) -> Path | io.BytesIO:
    """What Pillow opens: the file, or its bytes where a JPEG lacks its end marker alone, without
    which Pillow refuses it."""
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
    """Warn once for a file, which is decoded several times."""
    _log.warning("The last bytes of %s are missing, but all of its pixels are there.", path)


@contextmanager
def loaded(path: Path) -> Iterator[tuple[Any, bool]]:
    """A picture with all of its pixels, and whether its file has 16 bits a channel, of which Pillow
    keeps 8 in colours.

    Raises:
        DatasetError, FormatError, BackendError: as `opened_picture`, or pixels are missing.
    """
    with opened_picture(path) as image:
        deep = any(";16" in str(tile[3]) for tile in getattr(image, "tile", ()))
        check_whole(path, image)
        yield image, deep


def _developed(path: Path) -> Any:
    """A raw photo as PIL.Image.Image, with the EXIF orientation that its file states."""
    info = raw_info(path)
    check_pixels(path, info.width, info.height)
    rgb, turn = read_raw(path)
    image = pillow().fromarray(rgb)
    image.getexif()[ORIENTATION] = turn
    return image


def check_whole(path: Path, image: Any) -> None:
    """Load the pixels of a picture that was opened; FormatError where some are missing."""
    image.load()
    if reason := why_cut_short(path, image):
        raise _broken(path, reason)


def check_pixels(path: Path, width: int, height: int) -> None:
    """Raise FormatError for a picture of more than `MOST_PIXELS`."""
    if width * height > MOST_PIXELS:
        raise too_large(path, f"{width} x {height} pixels")


def too_large(path: Path, stated: str) -> FormatError:
    """The sentence for a header that states more than is read."""
    return FormatError(
        f"{path} states a size of {stated}, but pictures of more than "
        f"{number(MOST_PIXELS)} pixels are not read. Scale the pictures "
        f"down, or copy this one again if it is damaged."
    )


def _broken(path: Path, reason: str) -> FormatError:
    return FormatError(
        f"{path} cannot be read as an image: {reason}. Copy the file again, or remove it from the "
        f"capture."
    )
