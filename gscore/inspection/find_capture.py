"""Capture finder: the capture that a picked file or folder belongs to."""

from pathlib import Path

from ..datasets.programs import find_program
from ..datasets.transforms_json import find_transforms
from ..errors import DatasetError
from ..io.colmap.folder import find_model
from ..video import is_video


def find_capture(path: str | Path) -> Path:
    """The folder of the capture of a picked path.

    Users pick `sparse/0`, `sparse`, the photos or a file of the model; trainers need the folder
    above. The path of a capture, and one without a capture, is returned unchanged.
    """
    path = Path(path)
    if path.suffix.lower() == ".json" or is_video(path):
        return path
    folder = path.parent if path.is_file() else path
    if folder.name.isdigit() and folder.parent.name == "sparse":
        return folder.parent.parent
    if folder.name == "sparse":
        return folder.parent
    if not _has_capture(folder) and _has_capture(folder.parent):  # which may be a whole disk
        return folder.parent
    return folder


def colmap_of(folder: Path) -> Path | None:
    """The folder of the COLMAP model of a capture; None if there is none."""
    try:
        return find_model(folder)[0]
    except (DatasetError, OSError):
        return None


def _has_capture(folder: Path) -> bool:
    found = colmap_of(folder) or find_transforms(folder) or find_program(folder, below=False)
    return found is not None
