"""HEIC photos of phones, converted to JPEG with the package pillow-heif."""

import contextlib
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ..errors import FormatError
from ..extras import how_to_install, need
from ..io.images.pillow_images import BROKEN, check_pixels

HEIC_ENDINGS = (".heic", ".heif")
"""Of such photos, lower case."""
QUALITY = 97
"""Of the JPEG, with full colour resolution, as frames of a video have it."""


def is_heic(name: str) -> bool:
    """Whether a file's name is that of such a photo."""
    return name.lower().endswith(HEIC_ENDINGS)


def can_read() -> bool:
    """Whether pillow-heif is there."""
    return find_spec("pillow_heif") is not None


def readable(unread: list[str]) -> tuple[list[str], list[str]]:
    """Of photos of kinds that are not read as they are, those that become JPEG, and the rest."""
    mine = [name for name in unread if is_heic(name)] if can_read() else []
    return mine, [name for name in unread if name not in mine]


def size_of(path: Path) -> tuple[int, int]:
    """Width and height of the JPEG of a photo, px, without decoding it.

    Raises:
        FormatError, BackendError: as `write_jpeg`.
    """
    return _opened(path).size


def jpeg_name(name: str) -> str:
    """Name of the JPEG of a photo; the old ending stays in it, so that no other photo has it."""
    return f"{name}.jpg"


def what_to_do(unread: list[str]) -> str:
    """What makes photos readable that are not, as the end of a sentence."""
    if any(is_heic(name) for name in unread) and not can_read():
        return f"convert to JPEG, or for HEIC: {how_to_install('pillow_heif')}"
    return "convert to JPEG"


def write_jpeg(source: Path, target: Path) -> None:
    """Write a HEIC photo as JPEG, upright, with its EXIF and its colours as they are stored.

    Raises:
        FormatError: it is damaged or too large.
        BackendError: pillow-heif is not installed.
        OSError: the JPEG cannot be written.
    """
    file = _opened(source)
    with _told(source):
        picture = file.to_pillow().convert("RGB")
    kept = {name: picture.info[name] for name in ("exif", "icc_profile") if picture.info.get(name)}
    picture.save(target, "JPEG", quality=QUALITY, subsampling=0, **kept)


def _opened(path: Path) -> Any:
    reader = need("pillow_heif", "Reading HEIC photos")
    with _told(path):
        file = reader.open_heif(path)
    check_pixels(path, *file.size)
    return file


@contextlib.contextmanager
def _told(path: Path) -> Iterator[None]:
    try:
        yield
    except BROKEN as error:
        raise FormatError(
            f"{path} cannot be read as a HEIC photo: {str(error).rstrip('.')}. Copy the file "
            "again, or remove it."
        ) from error
