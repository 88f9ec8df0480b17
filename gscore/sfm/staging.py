"""Staging: photos of several sources, of converted formats, or frames of a video, for a capture."""

import contextlib
import json
import math
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..control import Control
from ..datasets.masks import MASK_FOLDER
from ..errors import Cancelled, ConfigError, DatasetError, GsError
from ..events import Event, SfmProgress
from ..io.files import atomic_write, link_or_copy, read_bytes, reason
from ..json_text import parse_json
from ..quoting import brief
from ..video import ExtractRequest, extract_frames, is_video
from . import heic, masks
from .photos import excluded_folders, list_photos, mask_folder, photo_folder, stamp
from .search_request import SearchRequest
from .workspace import check_without_cameras

RECORD = "sources.json"
"""File among the photos that records their sources."""
_PHASE = "gathering photos"


def is_staged(request: SearchRequest, sources: Sequence[Path]) -> bool:
    """Whether the photos must be collected in one folder, or converted to JPEG, before the
    search."""
    if len(sources) > 1:
        return True
    (source,) = sources
    if not source.is_dir() or photo_folder(source).resolve() == (request.output / IMAGES).resolve():
        return False  # photos already in the capture stay unchanged
    return has_heic(source)


def has_heic(folder: Path) -> bool:
    """Whether a folder contains HEIC photos and pillow-heif is installed."""
    return bool(heic.readable(list_photos(photo_folder(folder), ())[1])[0])


def stage_photos(
    request: SearchRequest,
    sources: Sequence[Path],
    *,
    frames: int = 0,
    on_event: Callable[[Event], None] = lambda event: None,
    control: Control | None = None,
) -> SearchRequest:
    """Put all photos and frames into `images` of the capture; return the request to search them.

    Each of several sources gets a folder there, with its own name or with a number appended. Photos
    are linked if the file system supports it, HEIC is converted to JPEG, masks go into `masks` of
    the capture. Photos staged earlier from the same sources are reused. The folder appears with one
    rename.

    Args:
        request: Its output is the capture; its `photos` is ignored.
        sources: Folders of photos, and videos.
        frames: Maximum number per video; 0: chosen by the motion.
        on_event: Receiver of progress events.
        control: Source of stop requests.

    Raises:
        Cancelled: `control` requested a stop; no files are left.
        ConfigError: a source is inside another, or the capture's folder contains other files.
        DatasetError: a source does not exist, or has no photos.
        FormatError: a HEIC photo cannot be read.
        GsError: a video cannot be read, or the photos cannot be written.
    """
    named = _named(sources)
    place = request.output / IMAGES
    if place.exists():
        if (found := staged_photos(request, sources, frames=frames)) is not None:
            return found
        raise ConfigError(
            f"{brief(place)} contains photos of other sources. Choose a new folder with -o, or "
            "remove that one."
        )
    state = _state(request, sources, frames)
    check_photo_folder(request.output)
    work = request.output.absolute() / f".{IMAGES}.gather"
    made = [p for p in (request.output, *request.output.absolute().parents) if not p.exists()]
    try:
        shutil.rmtree(work, ignore_errors=True)  # of a killed call; quick to redo
        (work / IMAGES).mkdir(parents=True)
        for source, name in named:
            staging = _SourceStaging(request, source, name, work, on_event, control or Control())
            staging.run(frames)
        atomic_write(work / IMAGES / RECORD, json.dumps(state).encode())
        if (work / MASK_FOLDER).exists():
            (work / MASK_FOLDER).rename(request.output / MASK_FOLDER)
        (work / IMAGES).rename(place)
    except OSError as error:
        raise GsError(f"Cannot write {brief(place)}: {reason(error)}") from error
    finally:
        shutil.rmtree(work, ignore_errors=True)
        if not place.exists():
            remove_empty(made)
    return _staged_request(request, sources)


def staged_photos(
    request: SearchRequest, sources: Sequence[Path], *, frames: int = 0
) -> SearchRequest | None:
    """The request for photos staged earlier from the same sources; None: there are none.

    Raises:
        DatasetError: a source does not exist.
    """
    state = _state(request, sources, frames)
    try:
        there = parse_json(read_bytes(request.output / IMAGES / RECORD))
    except (GsError, ValueError):
        return None
    return _staged_request(request, sources) if there == state else None


def _staged_request(request: SearchRequest, sources: Sequence[Path]) -> SearchRequest:
    return replace(request, photos=request.output, video=sources[0])


def remove_empty(folders: Sequence[Path]) -> None:
    """Remove empty folders, innermost first, up to the first that is not empty."""
    for folder in folders:
        try:
            folder.rmdir()
        except OSError:
            return


class _SourceStaging:
    """Staging of one source in the folder that becomes `images`."""

    def __init__(
        self,
        request: SearchRequest,
        source: Path,
        name: str,
        work: Path,
        show: Callable[[Event], None],
        control: Control,
    ) -> None:
        self._request, self._source, self._name = request, source, name
        self._work, self._show, self._control = work, show, control

    def run(self, frames: int) -> None:
        if is_video(self._source):
            extraction = ExtractRequest(video=self._source, output=self._target, frames=frames)
            extract_frames(extraction, on_event=self._show, control=self._control)
            return
        root = photo_folder(self._source)
        photos = _photos(self._request, root)
        if not photos:
            raise DatasetError(
                f"{root} contains no photos. Leave it out, or give the folder of the photos."
            )
        own = self._request.masks if not self._name else None  # one for all is read later
        found = {}
        if self._request.use_masks:
            found = masks.find_masks(mask_folder(root, own), root, photos)
        for done, name in enumerate(photos, 1):
            if self._control.stopping:
                raise Cancelled("Gathering the photos was stopped.")
            self._put(root / name, name, found.get(name))
            self._show(SfmProgress(phase=_PHASE, done=done, total=len(photos), eta_s=math.nan))

    @property
    def _target(self) -> Path:
        return self._work / IMAGES / self._name

    def _put(self, path: Path, name: str, mask: Path | None) -> None:
        changed = heic.is_heic(name)
        kept = heic.jpeg_name(name) if changed else name
        target = self._target / kept
        if changed:
            target.parent.mkdir(parents=True, exist_ok=True)
            heic.write_jpeg(path, target)
        else:
            link_or_copy(path, target)
        if mask is not None:
            link_or_copy(mask, self._work / MASK_FOLDER / self._name / f"{kept}.png")


def _named(sources: Sequence[Path]) -> list[tuple[Path, str]]:
    """The sources, each with the name of its folder; empty for a single source."""
    whole = [source.resolve() for source in sources]
    for i, path in enumerate(whole):
        for j, other in enumerate(whole):
            if i != j and path.is_relative_to(other):
                raise ConfigError(
                    f"{brief(sources[i])} was given twice."
                    if path == other
                    else f"{brief(sources[i])} is inside {brief(sources[j])}: its photos would "
                    "count twice. Leave it out."
                )
    if len(sources) == 1:
        return [(sources[0], "")]
    taken: set[str] = set()
    return [(source, _free(path, taken)) for source, path in zip(sources, whole, strict=True)]


def _free(path: Path, taken: set[str]) -> str:
    """A unique folder name for a source, also on case-insensitive file systems."""
    own = path.stem if is_video(path) else path.name
    if own.lower() in (IMAGES, "input") and path.parent.name:
        own = path.parent.name
    name, number = own, 1
    while name.lower() in taken:
        number += 1
        name = f"{own}-{number}"
    taken.add(name.lower())
    return name


def _photos(request: SearchRequest, root: Path) -> list[str]:
    """Names of the photos of a folder, including those to convert to JPEG."""
    names, unread = list_photos(root, excluded_folders(request, root))
    return names + heic.readable(unread)[0]


def _state(request: SearchRequest, sources: Sequence[Path], frames: int) -> dict[str, Any]:
    """Key of reusable staged photos, as JSON values."""
    return {"sources": [_stamps(request, path) for path in sources], "frames": frames}


def _stamps(request: SearchRequest, source: Path) -> list[Any]:
    if is_video(source):
        return [stamp(source.name, source)]
    root = photo_folder(source)
    return [stamp(name, root / name) for name in _photos(request, root)]


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


@contextlib.contextmanager
def photos_from(
    request: SearchRequest,
    sources: Sequence[Path],
    *,
    frames: int = 0,
    on_event: Callable[[Event], None] = lambda event: None,
    control: Control | None = None,
) -> Iterator[SearchRequest]:
    """Context manager that stages the photos of all sources; yields the request to search them.

    If the block raises DatasetError, because the photos give no model, the staged files are
    removed. A stopped or killed search keeps them to resume from.

    Args:
        request: Its output is the capture.
        sources: Folders of photos, and videos.
        frames: Maximum number per video; 0: chosen by the motion.
        on_event: Receiver of progress events.
        control: Source of stop requests.

    Raises:
        As `stage_photos` and `with_frames`.
    """
    if not (is_staged(request, sources) or is_video(sources[0])):
        yield request
        return
    capture = request.output
    check_without_cameras(capture)
    whole = capture.absolute()
    made = [p for p in (whole / MASK_FOLDER, whole / IMAGES) if not p.exists()]
    above = [p for p in (whole, *whole.parents) if not p.exists()]
    try:
        if is_staged(request, sources):
            request = stage_photos(
                request, sources, frames=frames, on_event=on_event, control=control
            )
        else:
            request = with_frames(request, frames=frames, on_event=on_event, control=control)
        yield request
    except DatasetError:
        for folder in made:
            shutil.rmtree(folder, ignore_errors=True)
        remove_empty(above)
        raise
