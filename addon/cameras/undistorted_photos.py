"""Undistorted photos: copies of distorted ones for Blender's pinhole cameras.

Such a camera has the K and the size that a training gives its photo (`Undistortion`); its
background is an undistorted copy of the photo, in a folder of the add-on.
"""

import hashlib
import json
from pathlib import Path

import numpy as np

from ..core import ColmapCamera, GsError, Undistortion, plan_undistortion
from ..interface.option_labels import error_text
from ..paths import own_folder
from .objects import PhotoCamera

_VERSION = 1
"""Version of the copies' contents; a new one invalidates all."""
_STEM, _DIGITS = 40, 16
"""Characters of the photo's name in the copy's name, and of each of its two hashes."""
_JPEG = frozenset({".jpg", ".jpeg"})
_PART = ".part"
"""Suffix of partially written files."""


def lens_of(own: PhotoCamera) -> ColmapCamera:
    """The camera of a photo in the capture."""
    width, height = own.taken
    K = own.K
    params = own.params or (K[0, 0], K[1, 1], K[0, 2], K[1, 2])
    return ColmapCamera(
        model=own.model, width=width, height=height, params=np.array(params, np.float64)
    )


def undistortion_of(own: PhotoCamera) -> Undistortion | None:
    """Undistortion of a photo for its Blender camera; None: it needs none.

    Raises:
        ValueError: the lens distortion cannot be undone, or the camera was imported without
            undistortion.
    """
    lens = lens_of(own)
    if own.photo_size is not None:
        return Undistortion(camera=lens, width=own.width, height=own.height, K=own.K)
    if lens.is_pinhole:
        return None
    try:
        plan_undistortion(lens)
    except GsError as error:
        raise ValueError(f"{own.image} cannot be undistorted. {error_text(error)}") from error
    raise ValueError(
        f"The lens of {own.image} has distortion ({own.model}), and its camera was imported "
        f"without undistortion: import the capture's cameras again."
    )


def copies_folder() -> Path:
    """Folder of the undistorted copies, which need not exist."""
    return own_folder() / "straight"


def copy_of(own: PhotoCamera, photo: Path) -> Path:
    """The file of a photo's undistorted copy, which may be missing; it changes with the photo and
    its lens.

    Args:
        own: The camera, imported with undistortion.
        photo: The photo, which must exist.
    """
    lens = [own.model, own.params, own.photo_size, own.K.tolist(), own.width, own.height]
    stat = photo.stat()
    which = _digits([_VERSION, str(photo), lens])
    state = _digits([stat.st_mtime_ns, stat.st_size])
    # JPEGs stay small; other formats may have alpha.
    ending = ".jpg" if photo.suffix.lower() in _JPEG else ".png"
    return copies_folder() / f"{photo.stem[:_STEM]}-{which}-{state}{ending}"


def earlier_copies(copy: Path) -> list[Path]:
    """Copies of the same photo and lens, from before the photo changed."""
    which = copy.stem.rsplit("-", 1)[0]
    others = (file for file in copies(copy.parent) if file != copy)
    return [file for file in others if file.stem.rsplit("-", 1)[0] == which]


def copies(folder: Path) -> list[Path]:
    """All copies in a folder."""
    files = folder.iterdir() if folder.is_dir() else ()
    return sorted(file for file in files if file.suffix in (".jpg", ".png") and file.is_file())


def part_of(copy: Path) -> Path:
    """Temporary file of a copy that is being written."""
    return copy.with_name(f".{copy.name}{_PART}")


def partial_files(folder: Path) -> list[Path]:
    """Partial files of killed programs in a folder."""
    return sorted(folder.glob(f".*{_PART}"))


def size_of(folder: Path) -> tuple[int, int]:
    """Number of copies in a folder, and their bytes."""
    sizes = [file.stat().st_size for file in copies(folder)]
    return len(sizes), sum(sizes)


def remove(files: list[Path]) -> None:
    """Remove copies."""
    for file in files:
        file.unlink(missing_ok=True)


def _digits(facts: object) -> str:
    return hashlib.sha256(json.dumps(facts).encode()).hexdigest()[:_DIGITS]
