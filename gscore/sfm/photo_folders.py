"""Photo folders: folders of plain photos, and the photos behind an earlier search."""

from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from ..datasets.pku.case import find_video
from ..datasets.programs import find_program
from ..datasets.transforms_json import find_transforms
from ..errors import DatasetError
from ..io.files import read_bytes
from ..io.runs import SEARCH_RECORD
from ..io.unsupported_formats import unread_cameras
from ..json_text import parse_json
from ..quoting import brief
from ..text_format import count_text, number
from .heic import readable
from .masks import mask_folder
from .photos import list_photos, photo_folder
from .search_request import SearchRequest

_FEW_CAMERAS = 3
"""One photographer may carry several cameras; a camera that is turned counts as two."""
_MODELS = ("sparse", "colmap", "cameras.bin", "cameras.txt")
_IN_CAPTURES = ("images", "input", "photos", "rgb")
"""Names of the folder of photos in a capture."""


def is_photo_folder(path: Path) -> bool:
    """Whether a folder contains photos and no camera files, not even unreadable ones."""
    if not path.is_dir() or find_video(path) or find_transforms(path):
        return False
    if any((path / name).exists() for name in _MODELS) or find_program(path):
        return False
    names, unread = list_photos(photo_folder(path), ())
    return bool(names or readable(unread)[0])


def check_no_cameras_above(path: Path) -> None:
    """Check that a folder of plain photos is not part of a capture with their cameras.

    Raises:
        DatasetError: it is; names the folder to give.
    """
    whole = path.absolute()
    if whole.name not in _IN_CAPTURES or not _has_cameras(whole.parent):
        return
    above = path.parent if path.name else whole.parent
    images = "" if whole.name == "images" else f" with `--images {whole.name}`"
    raise DatasetError(
        f"{path} contains only the photos; {above} contains their cameras too: give "
        f"{above}{images}. To find new cameras, copy the photos to a folder of their own."
    )


def captures_inside(root: Path, names: Sequence[str]) -> str:
    """Message on photos below a folder that belong to captures with cameras; empty if none do.

    Args:
        root: The folder.
        names: Paths below it, as returned by `list_photos`.
    """
    places = {place for name in names for place in PurePosixPath(name).parents if place.parts}
    captures = sorted(str(place) for place in places if _has_cameras(root / place))
    if not captures:
        return ""
    other = f" and {len(captures) - 1} more" if len(captures) > 1 else ""
    return (
        f"{root} is not a folder of photos: it contains a capture, {root / captures[0]}{other}. "
        "Give that folder, or move it away."
    )


def other_cameras(path: Path) -> str:
    """Message on another program's cameras among the photos, which a search does not use; empty if
    there are none.

    Args:
        path: The folder given to the search.
    """
    found = find_program(path) if path.is_dir() else None
    if found is None:
        return unread_cameras(path)
    return (
        f"{found.path} contains cameras of these photos ({found.program}), which gscore train and "
        "the add-on read. This search ignores them and finds new ones, with another scale and "
        "origin."
    )


def photo_folder_warning(root: Path, names: Sequence[str], cameras: int) -> str:
    """Message on why pictures are hardly photos of one scene; empty if there is no sign of it.

    Args:
        root: Their folder.
        names: Paths below it, as returned by `list_photos`.
        cameras: Number of cameras by sizes and EXIF.
    """
    if sentence := captures_inside(root, names):
        return sentence
    if (root / ".git").exists():
        return (
            f"{root} is a git repository, so its {count_text(len(names), 'picture')} are hardly "
            "photos of one scene. Give the folder of the photos."
        )
    if cameras > max(_FEW_CAMERAS, len(names) / 2):
        return (
            f"The {count_text(len(names), 'picture')} in {root} are of {number(cameras)} cameras "
            "or sizes, which is typical of screenshots, not of photos of one scene. Give the "
            "folder of the photos."
        )
    return ""


def _has_cameras(folder: Path) -> bool:
    """Whether a folder is a capture whose cameras are known."""
    stated = any((folder / name).exists() for name in (*_MODELS, "transforms.json"))
    return stated or find_program(folder, below=False) is not None


def photos_of(request: SearchRequest) -> list[list[Any]]:
    """Stamps (`stamp`) of the photos of a search, as JSON values.

    Raises:
        DatasetError: the folder does not exist.
    """
    root = photo_folder(request.photos)
    return [
        stamp(name, root / name) for name in list_photos(root, excluded_folders(request, root))[0]
    ]


def excluded_folders(request: SearchRequest, root: Path) -> tuple[Path, ...]:
    """Folders below the photo folder that are not searched for photos."""
    places = (mask_folder(root, request.masks), request.output, request.excluded)
    return tuple(place for place in places if place is not None)


def stamp(name: str, path: Path) -> list[Any]:
    """Name, size in bytes and modification time in ns of a file, as JSON values.

    Raises:
        DatasetError: it is gone.
    """
    try:
        stat = path.stat()
    except OSError as error:
        raise DatasetError(
            f"{brief(path)} is gone or cannot be read any more. Put it back, or start again "
            "without it, and do not change the photos while their cameras are found."
        ) from error
    return [name, stat.st_size, stat.st_mtime_ns]


def same_photos(capture: Path, photos: list[list[Any]]) -> bool:
    """Whether a capture was made of photos with these stamps (`photos_of`)."""
    try:
        return parse_json(read_bytes(capture / SEARCH_RECORD))["photos_read"] == photos
    except (DatasetError, ValueError, KeyError, TypeError):
        return False
