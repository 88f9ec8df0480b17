"""Photo folders: folders of plain photos, and the photos behind an earlier search."""

from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from ..datasets.pku.case import find_video
from ..datasets.programs import find_program
from ..datasets.transforms_json import find_transforms
from ..errors import DatasetError
from ..io.files import read_bytes
from ..io.foreign_cameras import unread_cameras
from ..io.runs import SEARCH_RECORD
from ..json_text import parse_json
from ..quoting import brief
from ..text_format import count_words, number
from .heic import readable
from .masks import mask_folder
from .photos import list_photos, photo_folder
from .search_request import SearchRequest

_FEW_CAMERAS = 3
"""As many may be in one bag; and a camera that is turned counts as two."""
_MODELS = ("sparse", "colmap", "cameras.bin", "cameras.txt")
_IN_CAPTURES = ("images", "input", "photos", "rgb")
"""Names of the folder of photos in a capture."""


def is_photo_folder(path: Path) -> bool:
    """Whether a folder holds photos and nothing that states their cameras, not even badly."""
    if not path.is_dir() or find_video(path) or find_transforms(path):
        return False
    if any((path / name).exists() for name in _MODELS) or find_program(path):
        return False
    names, unread = list_photos(photo_folder(path), ())
    return bool(names or readable(unread)[0])


def check_no_cameras_above(path: Path) -> None:
    """Raise where a folder of plain photos is a part of a capture, which has their cameras.

    Raises:
        DatasetError: says which folder to give.
    """
    whole = path.absolute()
    if whole.name not in _IN_CAPTURES or not _has_cameras(whole.parent):
        return
    above = path.parent if path.name else whole.parent
    images = "" if whole.name == "images" else f" --images {whole.name}"
    raise DatasetError(
        f"{path} holds the photos alone; {above} holds their cameras too: give {above}{images}. To "
        "find cameras anew, copy the photos to a folder of their own."
    )


def captures_inside(root: Path, names: Sequence[str]) -> str:
    """A sentence where photos below a folder belong to captures there, which have cameras already;
    empty where none do.

    Args:
        root: The folder.
        names: Paths below it, as `list_photos` gives them.
    """
    places = {place for name in names for place in PurePosixPath(name).parents if place.parts}
    captures = sorted(str(place) for place in places if _has_cameras(root / place))
    if not captures:
        return ""
    other = f" and {len(captures) - 1} more" if len(captures) > 1 else ""
    return (
        f"{root} is no folder of photos: it holds a capture, {root / captures[0]}{other}. Give "
        "that folder, or move it away."
    )


def other_cameras(path: Path) -> str:
    """A sentence where another program's cameras lie among the photos, which a search does not
    use; empty where none do.

    Args:
        path: The folder that the search was given.
    """
    found = find_program(path) if path.is_dir() else None
    if found is None:
        return unread_cameras(path)
    return (
        f"{found.path} holds cameras of these photos ({found.program}), which gscore train and the "
        "add-on read. This search does not use them and finds others, of another size and place."
    )


def doubt(root: Path, names: Sequence[str], cameras: int) -> str:
    """Why pictures are hardly photos of one scene, as a sentence; empty where nothing says so.

    Args:
        root: Their folder.
        names: Paths below it, as `list_photos` gives them.
        cameras: How many cameras took them, by sizes and EXIF.
    """
    if sentence := captures_inside(root, names):
        return sentence
    if (root / ".git").exists():
        return (
            f"{root} is a git repository, so its {count_words(len(names), 'picture')} are hardly "
            "photos of one scene. Give the folder of the photos."
        )
    if cameras > max(_FEW_CAMERAS, len(names) / 2):
        return (
            f"The {count_words(len(names), 'picture')} in {root} are of {number(cameras)} cameras "
            "or sizes, as screenshots are and photos of one scene hardly. Give the folder of the "
            "photos."
        )
    return ""


def _has_cameras(folder: Path) -> bool:
    """Whether a folder is a capture whose cameras are known."""
    stated = any((folder / name).exists() for name in (*_MODELS, "transforms.json"))
    return stated or find_program(folder, below=False) is not None


def photos_of(request: SearchRequest) -> list[list[Any]]:
    """Names, sizes and times of the photos that a search is to look at, as JSON values.

    Raises:
        DatasetError: there is no such folder.
    """
    root = photo_folder(request.photos)
    return [
        stamp(name, root / name) for name in list_photos(root, excluded_folders(request, root))[0]
    ]


def excluded_folders(request: SearchRequest, root: Path) -> tuple[Path, ...]:
    """Folders below that of the photos in which none are looked for."""
    places = (mask_folder(root, request.masks), request.output, request.apart)
    return tuple(place for place in places if place is not None)


def stamp(name: str, path: Path) -> list[Any]:
    """What changes where a file does.

    Raises:
        DatasetError: it is gone.
    """
    try:
        stat = path.stat()
    except OSError as error:
        raise DatasetError(
            f"{brief(path)} is gone or cannot be read any more. Put it back, or begin anew without "
            "it, and leave the photos alone while their cameras are found."
        ) from error
    return [name, stat.st_size, stat.st_mtime_ns]


def same_photos(capture: Path, photos: list[list[Any]]) -> bool:
    """Whether a capture was made of these, as `photos_of` gives them."""
    try:
        return parse_json(read_bytes(capture / SEARCH_RECORD))["photos_read"] == photos
    except (DatasetError, ValueError, KeyError, TypeError):
        return False
