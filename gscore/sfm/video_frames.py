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
    """The search for the photos that a request means: as given, or the frames of its video.

    Frames go into `images` of the capture, in which the cameras are then found in place; frames
    that are there already are not taken again.

    Args:
        request: Its `photos` may be a video.
        frames: How many at most; 0: as many as the motion asks for.
        on_event: Told how far it is.
        control: Asked whether to stop.

    Raises:
        Cancelled: `control` said so; nothing is left behind.
        ConfigError: the capture's folder holds something else, or cameras already.
        GsError: the video cannot be read, or the frames not be written; see `extract_frames`.
    """
    if not is_video(request.photos):
        return request
    check_without_cameras(request.output)
    asked = frames_request(request, frames)
    check_room(request.output)
    made = [p for p in (request.output, *request.output.absolute().parents) if not p.exists()]
    try:
        extract_frames(asked, on_event=on_event, control=control)
    except BaseException:
        for folder in made:
            with contextlib.suppress(OSError):
                folder.rmdir()  # only an empty one can be removed
        raise
    return of_frames(request)


def frames_request(request: SearchRequest, frames: int = 0) -> ExtractRequest:
    """Which frames of the request's video are taken, and where to."""
    return ExtractRequest(video=request.photos, output=request.output / IMAGES, frames=frames)


def of_frames(request: SearchRequest) -> SearchRequest:
    """The request for cameras of the frames, once they are there."""
    return replace(request, photos=request.output, video=request.photos)


def check_room(capture: Path) -> None:
    """Raise ConfigError where photos put into `images` of a capture would mix with other files."""
    if (capture / IMAGES).exists() or not capture.exists():
        return  # of that folder the rules of what is put into it hold
    if not capture.is_dir() or any(not file.name.startswith(".") for file in capture.iterdir()):
        raise ConfigError(f"{brief(capture)} is not empty. Choose a new folder with -o.")
