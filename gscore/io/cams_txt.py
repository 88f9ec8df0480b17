"""MVSNet cameras as text, one file per view: extrinsic, intrinsic, depth range."""

import re
from pathlib import Path

import numpy as np

from ..errors import DatasetError, FormatError
from ..quoting import brief, quoted
from .files import read_bytes

_NAME = re.compile(r"(\d+)_cam\.txt", re.IGNORECASE)


def list_cams(folder: Path) -> dict[int, Path]:
    """Files `<number>_cam.txt` of a folder by number, ascending.

    Raises:
        DatasetError: there is no such folder or no such file, or a number occurs twice.
    """
    if not folder.is_dir():
        raise DatasetError(
            f"There is no folder {folder} with the files <number>_cam.txt of the cameras."
        )
    found: dict[int, Path] = {}
    for path in sorted(folder.iterdir()):
        match = _NAME.fullmatch(path.name)
        if match is None:
            continue
        number = int(match[1])
        if number in found:
            raise DatasetError(
                f"{folder} has camera {number} twice, {found[number].name} and {path.name}. "
                f"Remove the wrong one."
            )
        found[number] = path
    if not found:
        raise DatasetError(f"{folder} has no file <number>_cam.txt. Copy the cameras into it.")
    return dict(sorted(found.items()))


def read_cam(path: Path) -> tuple[list[list[float]], list[list[float]]]:
    """Extrinsic matrix, 4 x 4, world to camera in OpenCV axes, and intrinsic matrix, 3 x 3, pixels.

    The depth range and interval after them are ignored.

    Raises:
        DatasetError: the file is missing.
        FormatError: it is not text, or a matrix is missing or has too few numbers.
    """
    try:
        words = read_bytes(path).decode("utf-8-sig").split()
    except UnicodeDecodeError as error:
        raise FormatError(f"{path} is not text. Copy the camera file again.") from error
    lower = [word.lower() for word in words]
    return _matrix(path, words, lower, "extrinsic", 4), _matrix(path, words, lower, "intrinsic", 3)


def _matrix(
    path: Path, words: list[str], lower: list[str], name: str, size: int
) -> list[list[float]]:
    """Parse `size` x `size` numbers after the word `name`."""
    layout = f"the word {quoted(name)} and {size * size} numbers after it"
    if name not in lower:
        raise FormatError(
            f"{path} has no {quoted(name)}; expected {layout}. Copy the camera file again."
        )
    at = lower.index(name) + 1
    try:
        values = np.array([float(word) for word in words[at : at + size * size]])
    except ValueError as error:
        raise FormatError(
            f"{path}: {brief(error)} in the {name} matrix; expected {layout}. Copy the camera "
            f"file again."
        ) from error
    if len(values) != size * size:
        raise FormatError(
            f"{path} ends within the {name} matrix ({len(values)} numbers); expected {layout}. "
            f"Copy the camera file again."
        )
    return values.reshape(size, size).tolist()
