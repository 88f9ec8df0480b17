"""Photos and soft mattes of one frame of a multi-view video, by camera number."""

import re
from pathlib import Path

from ...errors import DatasetError
from ...io.images.read_image import IMAGE_ENDINGS

VIEW_FOLDER = re.compile(r"cam_?(\d+)")
"""Folders of the cameras in `per_view`."""
PLAIN_FOLDERS = ("images", "image")
"""Folders of the original photos; the data set's scripts write either name."""
MATTE_FOLDERS = ("masks", "pha", "mask")
"""Folders of soft mattes of the people."""

_CAMERA = re.compile(r"(?:^|_)c_(\d+)(?:_|$)")
_ALONE = re.compile(r"(\d+)")


def camera_number(name: str) -> int | None:
    """Number in `image_c_007_f_000005.png`, or in `007.png`; None for other names."""
    stem = Path(name).stem
    match = _CAMERA.search(stem) or _ALONE.fullmatch(stem)
    return int(match[1]) if match else None


def pictures_by_camera(folder: Path) -> dict[int, Path]:
    """Pictures in a folder by camera number, ascending; empty without the folder.

    Raises:
        DatasetError: a camera has two pictures.
    """
    pictures: dict[int, Path] = {}
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        number = camera_number(path.name)
        if number is None or path.suffix.lower() not in IMAGE_ENDINGS:
            continue
        if number in pictures:
            raise DatasetError(
                f"{folder} has two pictures of camera {number}, {pictures[number].name} and "
                f"{path.name}. Keep one of them."
            )
        pictures[number] = path
    return dict(sorted(pictures.items()))


def photo_folder_name(root: Path, name: str) -> str:
    """Name of the photo folder in `root`: `name`, or for the default, `images`, a usual name.

    Raises:
        DatasetError: there is none.
    """
    names = PLAIN_FOLDERS if name == "images" else (name,)
    for folder in names:
        if (root / folder).is_dir():
            return folder
    others = sorted(path.name for path in root.iterdir() if path.is_dir()) if root.is_dir() else []
    there = f" (there are {', '.join(others)})" if others else ""
    raise DatasetError(
        f"There is no photo folder {' or '.join(names)} in {root}{there}. Give its name with "
        "`--images`."
    )


def mattes(root: Path, images: str) -> dict[int, Path]:
    """Soft mattes by camera number; empty for photos with their own alpha."""
    if Path(images).name not in PLAIN_FOLDERS:
        return {}
    return next((found for name in MATTE_FOLDERS if (found := pictures_by_camera(root / name))), {})
