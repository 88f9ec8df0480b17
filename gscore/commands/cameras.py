"""A training of plain photos: their cameras are found first, and kept in its folder."""

from dataclasses import replace
from pathlib import Path

from ..config import DataConfig
from ..control import Control
from ..errors import ConfigError, DatasetError
from ..events import Show
from ..io.foreign import foreign
from ..io.runs import CAPTURE
from ..sfm import Request, find_cameras
from ..sfm.plain import is_plain, photos_of, same_photos


def with_cameras(
    data: DataConfig,
    output: Path,
    show: Show,
    control: Control,
    *,
    allowed: bool,
    threads: int,
) -> DataConfig:
    """What to train on: as given, or the capture made of a folder of plain photos.

    Args:
        data: Its source may be a folder of photos without cameras.
        output: Folder of the training; the capture goes into it, and is used again where it is made
            of the same photos.
        show: Told how far it is.
        control: Asked whether to stop.
        allowed: Whether cameras may be found at all.
        threads: CPU threads; 0: one a core.

    Raises:
        Cancelled: `control` said so; the same call goes on from there.
        DatasetError: not `allowed`, or no cameras can be found.
        ConfigError: the folder holds a capture of other photos.
        BackendError: pycolmap is missing or too old.
        GsError: the output cannot be written.
    """
    if not is_plain(data.source):
        return data
    if not allowed:
        raise DatasetError(f"{foreign(data.source)} Or leave out --no-sfm: they are found then.")
    capture = output / CAPTURE
    request = Request(
        photos=data.source,
        output=capture,
        masks=Path(data.masks) if data.masks else None,
        use_masks=data.mask_mode != "none",
        invert_masks=data.invert_masks,
        threads=threads,
        apart=output,
    )
    if not capture.exists():
        find_cameras(request, on_event=show, control=control)
    elif not same_photos(capture, photos_of(request)):
        raise ConfigError(
            f"{capture} holds the cameras of other photos than those in {data.source}. Choose "
            "another output folder, or remove that one to find them anew."
        )
    # Masks are written as training reads them by itself, white where pixels count.
    return replace(data, source=capture, images="images", masks="", invert_masks=False)


def is_finding(output: Path) -> bool:
    """Whether a search for cameras in the folder of a training was stopped."""
    return (output / f".{CAPTURE}.sfm").is_dir()
