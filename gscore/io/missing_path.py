"""Messages on paths that do not exist, with the names nearby."""

from itertools import islice
from pathlib import Path

from ..quoting import brief, first_few, nearest

VIDEO_ENDINGS = (
    *(".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".mts", ".m2ts", ".ts", ".mpg", ".mpeg"),
    *(".3gp", ".wmv", ".flv", ".insv", ".lrv", ".mxf", ".ogv"),
)
"""Endings of files that count as videos without being opened."""
_MOST_NAMES = 10_000
"""Most names of a folder that are compared."""


def missing_path(path: Path, kind: str = "folder", advice: str = "") -> str:
    """Message that a path does not exist: the nearest name in its folder, or the videos there.

    Args:
        path: The path; one with the ending of a video is called a video.
        kind: What was expected: "folder", "file or folder".
        advice: A sentence that follows where no name is near.
    """
    kind = "video" if path.suffix.lower() in VIDEO_ENDINGS else kind
    text = f"There is no {kind} {brief(path)}"
    advice = f". {advice}" if advice else "."
    try:
        found = sorted(islice(path.parent.iterdir(), _MOST_NAMES))
    except OSError:  # no such folder, or access is denied
        return f"{text}{advice}"
    names = [near.name for near in found if near.name[0] != "."]
    if kind == "video":
        names = [name for name in names if Path(name).suffix.lower() in VIDEO_ENDINGS]
    elif kind == "folder":
        names = [name for name in names if (path.parent / name).is_dir()]
    if guess := nearest(path.name, names):
        return f"{text}; did you mean {brief(path.parent / guess)}?"
    if kind == "video" and names:
        return f"{text}; its folder has {first_few(names)}."
    return f"{text}{advice}"
