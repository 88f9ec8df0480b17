"""HEIC photos of phones, converted to JPEG with the package pillow-heif."""

import contextlib
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ..errors import FormatError
from ..extras import install_hint, need
from ..io.images.pillow_images import BROKEN, check_pixels

HEIC_ENDINGS = (".heic", ".heif")
"""File name endings of HEIC photos, lower case."""
QUALITY = 97
"""JPEG quality, with full colour resolution, as for frames of a video."""


def is_heic(name: str) -> bool:
    """Whether a file name ends like that of a HEIC photo."""
    return name.lower().endswith(HEIC_ENDINGS)


def can_read() -> bool:
    """Whether pillow-heif is installed."""
    return find_spec("pillow_heif") is not None


def readable(unread: list[str]) -> tuple[list[str], list[str]]:
    """Split photos of unsupported formats into those that are converted to JPEG, and the rest."""
    mine = [name for name in unread if is_heic(name)] if can_read() else []
    return mine, [name for name in unread if name not in mine]


def size_of(path: Path) -> tuple[int, int]:
    """Width and height of the JPEG of a photo, px, without decoding it.

    Raises:
        FormatError, BackendError: as `write_jpeg`.
    """
    return _opened(path).size


def header_of(path: Path) -> Any:
    """Pillow's image of a photo, with its size, EXIF and XMP; its pixels are not decoded.

    Raises:
        FormatError, BackendError: as `write_jpeg`.
    """
    _opened(path)
    with _as_format_error(path):
        return need("pillow_heif", "Reading HEIC photos").HeifImageFile(path)


def jpeg_name(name: str) -> str:
    """Name of the JPEG of a photo; it keeps the old ending, so it is unique."""
    return f"{name}.jpg"


def conversion_hint(unread: list[str]) -> str:
    """Instruction to make photos readable, as the end of a sentence."""
    if any(is_heic(name) for name in unread) and not can_read():
        return f"convert to JPEG, or for HEIC: {install_hint('pillow_heif')}"
    return "convert to JPEG"


def write_jpeg(source: Path, target: Path) -> None:
    """Write a HEIC photo as JPEG, upright, with its EXIF and its stored colours.

    Raises:
        FormatError: it is damaged or too large.
        BackendError: pillow-heif is not installed.
        OSError: the JPEG cannot be written.
    """
    file = _opened(source)
    with _as_format_error(source):
        picture = file.to_pillow().convert("RGB")
    kept = {name: picture.info[name] for name in ("exif", "icc_profile") if picture.info.get(name)}
    picture.save(target, "JPEG", quality=QUALITY, subsampling=0, **kept)


def _opened(path: Path) -> Any:
    reader = need("pillow_heif", "Reading HEIC photos")
    with _as_format_error(path):
        file = reader.open_heif(path)
    check_pixels(path, *file.size)
    return file


@contextlib.contextmanager
def _as_format_error(path: Path) -> Iterator[None]:
    try:
        yield
    except BROKEN as error:
        raise FormatError(
            f"{path} cannot be read as a HEIC photo: {str(error).rstrip('.')}. Copy the file "
            "again, or remove it."
        ) from error
