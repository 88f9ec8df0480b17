"""HEIC photos, as phones write them: made JPEG where the package pillow-heif reads them."""

from importlib.util import find_spec
from pathlib import Path

from ..errors import FormatError
from ..extras import how_to_install, need
from ..io.pillow import BROKEN, check_pixels

ENDINGS = (".heic", ".heif")
"""Of such photos, lower case."""
QUALITY = 97
"""Of the JPEG, with full colour resolution, as frames of a video have it."""


def is_heic(name: str) -> bool:
    """Whether a file's name is that of such a photo."""
    return name.lower().endswith(ENDINGS)


def can_read() -> bool:
    """Whether pillow-heif is there."""
    return find_spec("pillow_heif") is not None


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
    reader = need("pillow_heif", "Reading HEIC photos")
    try:
        file = reader.open_heif(source)
        check_pixels(source, *file.size)
        picture = file.to_pillow().convert("RGB")
    except FormatError:
        raise
    except BROKEN as error:
        raise FormatError(
            f"{source} cannot be read as a HEIC photo: {str(error).rstrip('.')}. Copy the file "
            "again, or remove it."
        ) from error
    kept = {name: picture.info[name] for name in ("exif", "icc_profile") if picture.info.get(name)}
    picture.save(target, "JPEG", quality=QUALITY, subsampling=0, **kept)
