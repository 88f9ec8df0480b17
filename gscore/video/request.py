"""Extraction request: video, output folder, number and format of the frames."""

from dataclasses import dataclass
from pathlib import Path

from ..errors import ConfigError
from ..io.files import is_file
from ..io.missing_path import VIDEO_ENDINGS
from ..quoting import quoted
from ..text_format import number

FRAME_FORMATS = ("jpg", "png")
"""Values of `ExtractRequest.format`."""
MOST_FRAMES = 100_000
FEWEST_FRAMES = 3
"""Least number of frames for SfM."""


def is_video(path: Path) -> bool:
    """True if a path is a file with the ending of a video; it is not opened."""
    return path.suffix.lower() in VIDEO_ENDINGS and is_file(path)


@dataclass(frozen=True, kw_only=True)
class ExtractRequest:
    """Options of a frame extraction.

    Raises:
        ConfigError: an option has an invalid value.
    """

    video: Path
    """The file."""
    output: Path
    """Folder for the frames: new, empty, or with the frames of this request."""
    frames: int = 0
    """Most frames; 0: chosen by the camera motion, 30 to 300."""
    format: str = "jpg"
    """One of `FRAME_FORMATS`; JPEG of quality 97 with full colour resolution, or PNG."""

    def __post_init__(self) -> None:
        if self.frames != 0 and not FEWEST_FRAMES <= self.frames <= MOST_FRAMES:
            raise ConfigError(
                f"frames is {quoted(self.frames)}, expected {FEWEST_FRAMES} to "
                f"{number(MOST_FRAMES)}, or 0 to choose by the motion."
            )
        if self.format not in FRAME_FORMATS:
            raise ConfigError(
                f"format is {quoted(self.format)}, expected one of {', '.join(FRAME_FORMATS)}."
            )
