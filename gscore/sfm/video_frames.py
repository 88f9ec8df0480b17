"""Video frames as the source of a camera search, extracted into its future capture."""

import contextlib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from ..control import Control
from ..errors import ConfigError
from ..events import Event
from ..quoting import brief
from ..video import ExtractRequest, extract_frames, is_video
from .search_request import SearchRequest
from .workspace import check_without_cameras

IMAGES = "images"
"""Folder of the frames in the capture."""


def with_frames(
    request: SearchRequest,
    *,
    frames: int = 0,
    on_event: Callable[[Event], None] = lambda event: None,
    control: Control | None = None,
) -> SearchRequest:
    """Extract the frames of a video; return the request to search them.

    Frames go into `images` of the capture, where the cameras are then found in place; existing
    frames are reused. A request for photos is returned unchanged.

    Args:
        request: Its `photos` may be a video.
        frames: Maximum number; 0: chosen by the motion.
        on_event: Receiver of progress events.
        control: Source of stop requests.

    Raises:
        Cancelled: `control` requested a stop; no files are left.
        ConfigError: the capture's folder contains other files, or already has cameras.
        GsError: the video cannot be read, or the frames cannot be written; see `extract_frames`.
    """
    if not is_video(request.photos):
        return request
    check_without_cameras(request.output)
    extraction = frames_request(request, frames)
    check_photo_folder(request.output)
    made = [p for p in (request.output, *request.output.absolute().parents) if not p.exists()]
    try:
        extract_frames(extraction, on_event=on_event, control=control)
    except BaseException:
        for folder in made:
            with contextlib.suppress(OSError):
                folder.rmdir()  # only an empty one can be removed
        raise
    return of_frames(request)


def frames_request(request: SearchRequest, frames: int = 0) -> ExtractRequest:
    """The extraction of the request's video into its capture."""
    return ExtractRequest(video=request.photos, output=request.output / IMAGES, frames=frames)


def of_frames(request: SearchRequest) -> SearchRequest:
    """The request to search the extracted frames."""
    return replace(request, photos=request.output, video=request.photos)


def check_photo_folder(capture: Path) -> None:
    """Raise ConfigError if photos put into `images` of a capture would mix with other files."""
    if (capture / IMAGES).exists() or not capture.exists():
        return  # the caller checks an existing folder of photos
    if not capture.is_dir() or any(not file.name.startswith(".") for file in capture.iterdir()):
        raise ConfigError(f"{brief(capture)} is not empty. Choose a new folder with -o.")
