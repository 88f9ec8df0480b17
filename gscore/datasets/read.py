"""Reader of a capture folder in any layout; numpy only."""

from dataclasses import replace

import numpy as np

from ..config import DataConfig
from ..errors import ConfigError, DatasetError
from ..io.colmap.folder import find_model
from .capture import Capture
from .colmap_source import read_colmap
from .folder import masks_by_photos
from .masks import masks_inside
from .origin import about_origin
from .pku.case import find_video, read_video
from .programs import find_program, read_program
from .rig import with_rig
from .transforms_json import find_transforms, read_transforms


def read_capture(
    config: DataConfig, *, photos_required: bool = True, origin: np.ndarray | None = None
) -> Capture:
    """Views, cameras and points of a COLMAP model, a transforms.json, a frame of a multi-view
    video, or the camera file of another program.

    No photo is decoded. With `config.rig`, cameras and world are those of that capture. If
    coordinates are too large for float32, views and points are relative to a local origin.

    Args:
        config: `source`, `images`, `frame` and `rig`.
        photos_required: Leave out views without a photo and refuse a capture that lacks most; else
            all views stay, with the path where their photo should be.
        origin: As for `about_origin`.

    Raises:
        DatasetError: there is no capture, or its photos are missing, or the rig differs.
        FormatError: a file is truncated, corrupt or of an unknown format.
        ConfigError: `frame` was given for a capture that has none.
    """
    capture = _with_masks(_read(config, photos_required))
    if config.rig is not None:
        rig = _read(DataConfig(source=config.rig), False)
        capture = with_rig(capture, rig, where=config.source, rig_at=config.rig)
        capture = replace(capture, origin=rig.origin)
    return about_origin(capture, origin)


def _with_masks(capture: Capture) -> Capture:
    """The capture with the masks next to its photos, if it states none and has no folder of
    masks."""
    if any(view.mask for view in capture.views) or masks_inside(capture.root) is not None:
        return capture
    found = masks_by_photos([view.image for view in capture.views])
    if not any(found):
        return capture
    views = [replace(view, mask=mask) for view, mask in zip(capture.views, found, strict=True)]
    return replace(capture, views=views)


def _read(config: DataConfig, photos_required: bool) -> Capture:
    video = find_video(config.source)
    if video is not None:
        return read_video(video, config, photos_required=photos_required)
    if config.frame is not None and config.source.exists():
        raise ConfigError(
            f"{config.source} is no multi-view video, so it has no frame {config.frame}; expected "
            f"a folder with data_COLMAP, per_frame or per_view. Leave `--frame` out."
        )
    program = find_program(config.source, config.images) if config.source.is_file() else None
    if program is not None:
        return read_program(config, program, photos_required=photos_required)
    transforms = find_transforms(config.source)
    if transforms == config.source:
        return read_transforms(config, photos_required=photos_required)
    try:
        find_model(config.source)
    except DatasetError:
        if transforms is not None:
            return read_transforms(config, photos_required=photos_required)
        program = find_program(config.source, config.images)
        if program is None:
            raise
        return read_program(config, program, photos_required=photos_required)
    return read_colmap(config, photos_required=photos_required)
