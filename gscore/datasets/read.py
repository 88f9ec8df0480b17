"""A capture folder read as its files state it, whatever its layout; numpy alone."""

from ..config import DataConfig
from ..errors import DatasetError
from ..io.colmap import find_model
from .capture import Capture
from .colmap_source import read_colmap
from .transforms_json import FILES, find_transforms, read_transforms


def read_capture(config: DataConfig, *, photos_required: bool = True) -> Capture:
    """Views, cameras and points of a COLMAP model or a transforms.json; no photo is decoded.

    Args:
        config: `source` and `images`.
        photos_required: Leave out views whose photo is missing and refuse a capture that misses
            most; else all views stay, with the file where their photo should be.

    Raises:
        DatasetError: there is no capture, or its photos are missing.
        FormatError: a file is truncated, corrupt or of an unknown kind.
    """
    transforms = find_transforms(config.source)
    if transforms == config.source:
        return read_transforms(config, photos_required=photos_required)
    try:
        find_model(config.source)
    except DatasetError as error:
        if transforms is not None:
            return read_transforms(config, photos_required=photos_required)
        if not config.source.is_dir():
            raise
        raise DatasetError(f"{error} Nor is there a {' or '.join(FILES)}.") from error
    return read_colmap(config, photos_required=photos_required)
