"""COLMAP source: a capture from a COLMAP model and a folder of photos."""

from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any, TypeGuard

import numpy as np

from ..config import DataConfig
from ..errors import DatasetError, GsError
from ..io.block_record import read_block
from ..io.colmap.folder import ColmapModel, read_model
from ..io.colmap.model import ColmapPoints, PointIndex
from ..io.files import is_file, read_bytes
from ..io.runs import SEARCH_RECORD
from ..json_text import parse_json
from ..quoting import first_few
from ..scene import PointCloud, within_reach
from ..text_format import count_text
from .capture import Capture, View, repeated
from .folder import Folder


def read_colmap(config: DataConfig, *, photos_required: bool = True) -> Capture:
    """Read the model in `config.source` and find its photos in `config.images`.

    Views whose photo is missing are left out with a warning if at least half of the photos exist.
    Without `photos_required` all views stay, with the path where their photo should be.

    Raises:
        DatasetError: there is no model, no image folder, or most photos are missing.
        FormatError: the model is corrupt.
    """
    model = read_model(config.source, observations=_all_black)
    if not model.images:
        raise DatasetError(
            f"The COLMAP model in {model.path} has no images. Run COLMAP's mapper again, with more "
            f"overlap between the photos."
        )
    names = [image.name for image in model.images]
    if duplicates := repeated(names):
        raise DatasetError(
            f"The COLMAP model in {model.path} has several images of the same name: "
            f"{first_few(duplicates)}. Export the model from COLMAP again."
        )
    root = _photo_root(config, names)
    if photos_required and not root.is_dir():
        raise DatasetError(
            f"There is no image folder {root}. Give the folder of both the photos and the model, "
            f"and the name of the photo folder in it with `--images`."
        )
    files, warnings = _photo_files(model, names, root, required=photos_required)
    warnings = [*model.warnings, *search_warnings(config.source, len(names)), *warnings]
    seen = _observed(model)
    points = PointCloud(points=model.points.xyz, colors=model.points.rgb)
    views = [
        View(
            name=image.name,
            image=file or root / image.name,
            viewmat=image.viewmat,
            camera=model.cameras[image.camera_id],
            observed=seen[i],
        )
        for i, (image, file) in enumerate(zip(model.images, files, strict=True))
        if file is not None or not photos_required
    ]
    block = read_block(config.source)
    return Capture(
        root=config.source,
        views=views,
        points=points,
        up=model.up,
        origin=model.origin,
        error_px=_mean_error(model.points),
        test_names=frozenset(block.test_names if block else ()),
        masks_are=block.masks_are if block else "",
        warnings=tuple(warnings),
    )


def _photo_files(
    model: ColmapModel, names: list[str], root: Path, *, required: bool
) -> tuple[list[Path | None], list[str]]:
    """The photo of each image of the model in `root`, None where it is missing, and messages.

    Raises:
        DatasetError: most photos are missing, and `required`.
    """
    folder = Folder(root)
    files = folder.find_images(names)
    missing = [name for name, file in zip(names, files, strict=True) if file is None]
    count = f"{len(missing)} of the {count_text(len(names), 'image')} of the model"
    if required and 2 * len(missing) > len(names):
        raise DatasetError(
            f"{count} in {model.path} are missing in {root} ({count_text(len(folder), 'image')} "
            f"there): {first_few(missing)}. Give the folder of the photos that COLMAP was run on "
            "with `--images`."
        )
    warnings = []
    if missing:
        rest = f"; going on with the other {len(names) - len(missing)}" if required else ""
        warnings.append(f"{count} are missing in {root}: {first_few(missing)}{rest}.")
    renamed = [
        f"{name} -> {file.relative_to(root).as_posix()}"
        for name, file in zip(names, files, strict=True)
        if file is not None and file != root / name
    ]
    if renamed:
        warnings.append(
            f"{count_text(len(renamed), 'image is', 'images are')} named differently in {root}; "
            f"used: {first_few(renamed, 3)}."
        )
    return files, warnings


def _photo_root(config: DataConfig, names: list[str]) -> Path:
    """Folder of the photos: that of the option; if its default is missing, `input` or the capture
    itself, if they have photos of the model."""
    root = config.source / config.images
    if root.is_dir() or config.images != "images":
        return root
    if (config.source / "input").is_dir():
        return config.source / "input"
    photos = (config.source / part for name in names for part in (name, PurePosixPath(name).name))
    return config.source if any(map(is_file, photos)) else root


def _mean_error(points: ColmapPoints) -> float | None:
    """Mean reprojection error in pixels; None if no point states one."""
    stated = points.error[points.error >= 0]
    return float(stated.mean()) if len(stated) else None


def _all_black(points: ColmapPoints) -> bool:
    """True if the points have no colours, so that observations are needed to take colours from the
    photos."""
    return not points.rgb[within_reach(points.xyz)].any()


def _observed(model: ColmapModel) -> Sequence[np.ndarray | None]:
    """Indices of the points observed in each image, [M] int64; None: not needed, or unknown."""
    if not (_all_black(model.points) and model.points.track_lengths.any()):
        return [None] * len(model.images)
    index = PointIndex(model.points)
    return [np.unique(index.find(image.point3D_ids)[1]) for image in model.images]


def unplaced_photos_text(others: Sequence[Sequence[str]], alone: Sequence[str]) -> list[str]:
    """Messages about photos without a camera, with the remedy.

    Args:
        others: Names of the photos of each model but the largest.
        alone: Names of the photos in no model.
    """
    messages = [
        f"{count_text(len(other), 'photo forms', 'photos form')} a separate model and "
        f"{'is' if len(other) == 1 else 'are'} left out: {first_few(list(other))}. If it is the "
        "same scene, take photos between the two; if not, use separate folders."
        for other in others
    ]
    if alone:
        messages.append(
            f"{count_text(len(alone), 'photo matches', 'photos match')} no other: "
            f"{first_few(list(alone))}. Take photos between these and the others, or remove them "
            "if they are too blurred or show another scene."
        )
    return messages


def search_warnings(source: Path, views: int) -> list[str]:
    """Warning if gscore's SfM found cameras for only some of a capture's photos.

    Args:
        source: The capture.
        views: Number of views of its model; a record with another number is of another model.
    """
    try:
        record = parse_json(read_bytes(source / SEARCH_RECORD))
    except (GsError, ValueError):
        return []  # cameras from another program
    if not isinstance(record, dict) or record.get("registered") != views:
        return []
    others, alone, photos = record.get("others"), record.get("alone"), record.get("photos")
    if not (isinstance(others, list) and all(map(_are_names, others)) and _are_names(alone)):
        return []
    if not (isinstance(photos, int) and (messages := unplaced_photos_text(others, alone))):
        return []
    return [" ".join([f"{views} of {count_text(photos, 'photo')} have a camera.", *messages])]


def _are_names(value: Any) -> TypeGuard[list[str]]:
    return isinstance(value, list) and all(isinstance(name, str) for name in value)
