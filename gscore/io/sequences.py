"""Sequence folder of a sequence training, read without torch: options and frames."""

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import DatasetError, FormatError
from ..json_text import parse_json
from ..quoting import brief
from .colmap.folder import is_safe_name
from .files import atomic_write, read_bytes
from .metrics_file import is_number

FRAME_FOLDER = re.compile(r"frame_\d{6,}")
"""Names of the frames' folders."""
SEQUENCE_FILE = "sequence.json"
"""List of frames in the folder of a sequence."""


_NUMBERS = ("steps", "train_seconds", "psnr", "psnr_masked", "ssim", "lpips")
_NUMBERS += ("frames", "frames_total")


@dataclass(frozen=True, kw_only=True)
class SequenceIndex:
    """Content of a sequence.json."""

    options: dict[str, Any]
    """Options of the sequence in addition to those of its frames."""
    frames: list[dict[str, Any]]
    """Complete frames in order: at least `frame` (number) and `folder` (below the sequence's), and
    if known `start`, `splats`, `steps`, `train_seconds`, `psnr`, `ssim`, `lpips`, `split`, and with
    masks `psnr_masked`, see `gscore.headline_psnr`."""
    mean: dict[str, Any]
    """Means over the complete frames: `psnr`, `psnr_masked`, `ssim`, `lpips`; and `train_seconds`
    of all, `frames` and `frames_total`."""


def read_sequence(folder: Path) -> SequenceIndex | None:
    """Read the list of frames in the folder of a sequence; None without one.

    Raises:
        FormatError: it is damaged or another file.
    """
    path = folder / SEQUENCE_FILE
    if not path.is_file():
        return None
    try:
        content = parse_json(read_bytes(path))
        index = SequenceIndex(
            options=dict(content["options"]),
            frames=[dict(entry) for entry in content["frames"]],
            mean=dict(content["mean"]),
        )
        if all(_is_sound(entry) for entry in index.frames) and _is_known(index.mean):
            return index
        reason = "a frame without number, splat count or folder below the sequence's, or a metric "
        reason += "that is not a number"
    except (DatasetError, ValueError, KeyError, TypeError) as error:
        reason = f"{type(error).__name__}: {brief(error)}"
    raise FormatError(
        f"{path} is not the list of a sequence's frames ({reason}); remove it, or choose another "
        f"folder."
    )


def _is_sound(entry: dict[str, Any]) -> bool:
    folder, splats = entry["folder"], entry.get("splats", 0)
    inside = isinstance(folder, str) and is_safe_name(folder)
    return inside and all(type(n) is int for n in (entry["frame"], splats)) and _is_known(entry)


def _is_known(entry: dict[str, Any]) -> bool:
    """True if the entries of a frame, or of the mean, have the types that gscore writes."""
    numbers = [entry.get(key) for key in _NUMBERS]
    texts = [entry.get(key) for key in ("start", "split")]
    return all(n is None or is_number(n) for n in numbers) and all(
        text is None or isinstance(text, str) for text in texts
    )


def write_sequence(folder: Path, index: SequenceIndex, *, version: str) -> None:
    """Write the list of frames, completely or not at all.

    Raises:
        GsError: the file cannot be written.
    """
    content = {"gscore": version, **vars(index)}
    atomic_write(folder / SEQUENCE_FILE, (json.dumps(content, indent=2) + "\n").encode())
