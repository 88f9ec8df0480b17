"""Folders of plain photos, and which photos the capture of an earlier search was made of."""

from pathlib import Path
from typing import Any

from ..datasets.pku import find_video
from ..datasets.transforms_json import find_transforms
from ..errors import DatasetError
from ..io.files import read_bytes
from ..json_text import parse_json
from .masks import mask_folder
from .photos import list_photos, photo_folder
from .request import Request

SFM_FILE = "sfm.json"
"""In a capture: what was found, and of which photos."""
_MODELS = ("sparse", "colmap", "cameras.bin", "cameras.txt")


def is_plain(path: Path) -> bool:
    """Whether a folder holds photos and nothing that states their cameras, not even badly."""
    if not path.is_dir() or find_video(path) or find_transforms(path):
        return False
    if any((path / name).exists() for name in _MODELS):
        return False
    return bool(list_photos(photo_folder(path), ())[0])


def photos_of(request: Request) -> list[list[Any]]:
    """Names, sizes and times of the photos that a search is to look at, as JSON values.

    Raises:
        DatasetError: there is no such folder.
    """
    root = photo_folder(request.photos)
    return [stamp(name, root / name) for name in list_photos(root, apart_of(request, root))[0]]


def apart_of(request: Request, root: Path) -> tuple[Path, ...]:
    """Folders below that of the photos in which none are looked for."""
    places = (mask_folder(root, request.masks), request.output, request.apart)
    return tuple(place for place in places if place is not None)


def stamp(name: str, path: Path) -> list[Any]:
    """What changes where a file does."""
    stat = path.stat()
    return [name, stat.st_size, stat.st_mtime_ns]


def same_photos(capture: Path, photos: list[list[Any]]) -> bool:
    """Whether a capture was made of these, as `photos_of` gives them."""
    try:
        return parse_json(read_bytes(capture / SFM_FILE))["photos_read"] == photos
    except (DatasetError, ValueError, KeyError, TypeError):
        return False
