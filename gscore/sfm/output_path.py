"""Output path: default folder of the capture made from a source, or an earlier capture of it."""

import itertools
from dataclasses import dataclass
from pathlib import Path

from ..errors import GsError
from ..video import is_video
from ..video.frame_folder import FrameFolder
from .photos import is_photo_folder, photo_folder, photos_of, same_photos
from .search_request import SearchRequest
from .staging import IMAGES, frames_request, has_heic, of_frames, staged_photos


@dataclass(frozen=True)
class CaptureOutput:
    """The capture of photos or of a video."""

    capture: Path
    """Folder of the capture."""
    exists: bool
    """Whether it was made earlier from the same photos or video."""


def has_no_cameras(source: Path) -> bool:
    """Whether a path is a video or a folder of plain photos, the input of a camera search."""
    return is_video(source) or is_photo_folder(source)


def default_capture_output(source: Path) -> CaptureOutput:
    """The capture for a source without cameras (`has_no_cameras`); creates nothing.

    Photos in `images` of a folder get their cameras there. Else it is `NAME-capture` next to the
    source, with a number if that name is taken.
    """
    whole = source.absolute()
    stays = whole.is_dir() and not has_heic(whole)  # HEIC becomes JPEG, in another folder
    if stays and whole.parts and photo_folder(whole) == whole / IMAGES:
        return CaptureOutput(whole, False)
    if stays and whole.name == IMAGES:
        return CaptureOutput(whole.parent, False)
    name = whole.stem if is_video(whole) else whole.name
    for number in itertools.count(1):
        place = whole.with_name(f"{name}-capture" + (f"-{number}" if number > 1 else ""))
        request = SearchRequest(photos=whole, output=place)
        if _is_made_of(request):
            return CaptureOutput(place, True)
        if _is_free(request):
            return CaptureOutput(place, False)
    raise AssertionError("itertools.count does not end")


def _is_made_of(request: SearchRequest) -> bool:
    if not (request.output / "sparse").exists():
        return False
    if not is_video(request.photos):
        there: SearchRequest | None = request
        if has_heic(request.photos):
            there = staged_photos(request, [request.photos])
        return there is not None and same_photos(request.output, photos_of(there))
    return _has_frames(request) and same_photos(request.output, photos_of(of_frames(request)))


def _is_free(request: SearchRequest) -> bool:
    """Whether a search can start at the output, or resume from frames extracted earlier."""
    place = request.output
    if (place / "sparse").exists():
        return False
    if not place.exists() or (place.is_dir() and not any(place.iterdir())):
        return True
    return is_video(request.photos) and _has_frames(request)


def _has_frames(request: SearchRequest) -> bool:
    try:
        return FrameFolder(frames_request(request)).found is not None
    except GsError:
        return False
