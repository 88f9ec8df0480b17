"""Photos and soft mattes of one frame of a multi-view video, by camera number."""

import re
from pathlib import Path

from ...errors import DatasetError
from ...io.images.read_image import IMAGE_ENDINGS

VIEW_FOLDER = re.compile(r"cam_?(\d+)")
"""Folders of the cameras in `per_view`."""
PLAIN_FOLDERS = ("images", "image")
"""Photos as they were taken; the data set's scripts write either name."""
MATTE_FOLDERS = ("masks", "pha", "mask")
"""Soft opacity of the people."""

_CAMERA = re.compile(r"(?:^|_)c_(\d+)(?:_|$)")
_ALONE = re.compile(r"(\d+)")


def camera_number(name: str) -> int | None:
    """Number in `image_c_007_f_000005.png`, or in `007.png`; None for other names."""
    stem = Path(name).stem
    match = _CAMERA.search(stem) or _ALONE.fullmatch(stem)
    return int(match[1]) if match else None


def pictures_by_camera(folder: Path) -> dict[int, Path]:
    """The pictures in a folder by camera number, rising; empty without the folder.

    Raises:
        DatasetError: a camera has two pictures.
    """
    found: dict[int, Path] = {}
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        number = camera_number(path.name)
        if number is None or path.suffix.lower() not in IMAGE_ENDINGS:
            continue
        if number in found:
            raise DatasetError(
                f"{folder} has two pictures of camera {number}, {found[number].name} and "
                f"{path.name}. Keep one of them."
            )
        found[number] = path
    return dict(sorted(found.items()))


def photo_folder_name(root: Path, asked: str, *, default: str = "images") -> str:
    """Name of the photo folder in `root`: what was asked for, or one of the usual names.

    Raises:
        DatasetError: there is none.
    """
    names = PLAIN_FOLDERS if asked == default else (asked,)
    for name in names:
        if (root / name).is_dir():
            return name
    others = sorted(path.name for path in root.iterdir() if path.is_dir()) if root.is_dir() else []
    raise DatasetError(
        f"There is no photo folder {' or '.join(names)} in {root}"
        f"{f' (there are {chr(44).join(others)})' if others else ''}. Give its name with --images."
    )


def mattes(root: Path, images: str) -> dict[int, Path]:
    """Soft opacity by camera number; none for photos that carry it themselves."""
    if Path(images).name not in PLAIN_FOLDERS:
        return {}
    return next((found for name in MATTE_FOLDERS if (found := pictures_by_camera(root / name))), {})
