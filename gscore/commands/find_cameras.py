"""SfM before a training of photos without cameras or a video; cameras go into the run's folder."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from ..config import DataConfig
from ..control import Control
from ..errors import ConfigError, DatasetError
from ..events import Show
from ..io.runs import CAPTURE
from ..io.unsupported_formats import describe_unsupported
from ..sfm import SearchRequest, find_cameras
from ..sfm.output_path import has_no_cameras
from ..sfm.photo_folders import check_no_cameras_above, photos_of, same_photos
from ..sfm.photo_sources import photos_from
from ..sfm.staging import is_staged, stage_photos
from ..sfm.video_frames import frames_request, of_frames
from ..video import extract_frames, is_video


def with_cameras(
    data: DataConfig,
    output: Path,
    show: Show,
    control: Control,
    *,
    allowed: bool,
    check: Callable[[list[str] | None], None],
    threads: int,
) -> DataConfig:
    """The data options as given, or for the capture found by SfM from photos or a video.

    Args:
        data: Its source may be a folder of photos without cameras, or a video.
        output: Folder of the training, for the capture; a capture of the same photos in it is
            reused.
        show: Receives progress events.
        control: Polled for stop requests.
        allowed: Whether SfM may run.
        check: Called before SfM, which takes long, with the names of the photos, or None if they
            do not exist yet; raises if the training is impossible.
        threads: CPU threads; 0: all cores.

    Raises:
        Cancelled: `control` requested a stop; the same call continues from there.
        DatasetError: not `allowed`, no cameras can be found, or the parent folder contains them.
        ConfigError: the folder contains a capture of other photos.
        BackendError: pycolmap is missing or too old, or PyAV is missing.
        GsError: the video cannot be read, or the output cannot be written.
    """
    if not has_no_cameras(data.source):
        return data
    check_no_cameras_above(data.source)
    if not allowed:
        raise DatasetError(
            f"Leave out `--no-sfm` to find the cameras. {describe_unsupported(data.source)}"
        )
    capture = output / CAPTURE
    # Masks are written in the training's default form, white where pixels count.
    found = replace(data, source=capture, images="images", masks="", invert_masks=False)
    request = SearchRequest(
        photos=data.source,
        output=capture,
        masks=Path(data.masks) if data.masks else None,
        use_masks=data.mask_mode != "none",
        invert_masks=data.invert_masks,
        threads=threads,
        excluded=output,
    )
    if not (capture / "sparse").exists():
        whole = not (is_video(data.source) or is_staged(request, [data.source]))
        check([name for name, *_ in photos_of(request)] if whole else None)
        with photos_from(request, [data.source], on_event=show, control=control) as photos:
            find_cameras(photos, on_event=show, control=control)
        return found
    if is_video(data.source):
        extract_frames(frames_request(request), on_event=show, control=control)  # reuses frames
        request = of_frames(request)
    elif is_staged(request, [data.source]):
        request = stage_photos(request, [data.source], on_event=show, control=control)  # reuses
    if not same_photos(capture, photos_of(request)):
        raise ConfigError(
            f"{capture} contains the cameras of other photos than those in {data.source}. Choose "
            "another output folder, or remove that one to find the cameras again."
        )
    return found


def is_finding(output: Path) -> bool:
    """Whether the folder of a training contains an unfinished SfM."""
    return (output / f".{CAPTURE}.sfm").is_dir()
