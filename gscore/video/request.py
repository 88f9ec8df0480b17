"""Extraction request: video, output folder, number and format of the frames."""

from dataclasses import dataclass
from pathlib import Path

from ..errors import ConfigError
from ..io.files import is_file
from ..quoting import quoted
from ..text_format import number

VIDEO_ENDINGS = (
    *(".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".mts", ".m2ts", ".ts", ".mpg", ".mpeg"),
    *(".3gp", ".wmv", ".flv", ".insv", ".lrv", ".mxf", ".ogv"),
)
"""What a file is called that is taken for a video without being opened."""
FRAME_FORMATS = ("jpg", "png")
"""Values of `ExtractRequest.format`."""
MOST_FRAMES = 100_000
FEWEST_FRAMES = 3
"""What cameras can be found from at all."""


def is_video(path: Path) -> bool:
    """Whether a path is a file with the name of a video; it is not opened."""
    return path.suffix.lower() in VIDEO_ENDINGS and is_file(path)


@dataclass(frozen=True, kw_only=True)
class ExtractRequest:
    """Options of a choice of frames.

    Raises:
        ConfigError: an option has a value that cannot work.
    """

    video: Path
    """The file."""
    output: Path
    """Folder for the frames: a new one, an empty one, or one with the frames of this request."""
    frames: int = 0
    """How many at most; 0: as many as the motion asks for, 30 to 300."""
    format: str = "jpg"
    """One of `FRAME_FORMATS`; JPEG of quality 97 with full colour resolution, or PNG."""

    def __post_init__(self) -> None:
        if self.frames != 0 and not FEWEST_FRAMES <= self.frames <= MOST_FRAMES:
            raise ConfigError(
                f"frames is {quoted(self.frames)}, expected {FEWEST_FRAMES} to "
                f"{number(MOST_FRAMES)}, or 0 for as many as the motion asks for."
            )
        if self.format not in FRAME_FORMATS:
            raise ConfigError(
                f"format is {quoted(self.format)}, expected one of {', '.join(FRAME_FORMATS)}."
            )
