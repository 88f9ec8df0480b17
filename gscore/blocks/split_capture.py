"""Capture split: assignment of photos and points of a capture to blocks.

Blocks are selected as in VastGaussian (Lin et al. 2024, arXiv 2402.17427, section 4.1): a photo
belongs to each block of which it shows enough, and a block has all points visible in its photos,
also those outside its cell, because its photos need splats there.
"""

import contextlib
import hashlib
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

import numpy as np

from ..config import DataConfig
from ..datasets.capture import Capture, View
from ..datasets.masks import masks_of_views
from ..datasets.photo_headers import up_from_exif
from ..datasets.read import read_capture
from ..datasets.shots import warn_of_split_shots
from ..datasets.split import is_chosen, split_views
from ..datasets.tracks import model_with
from ..errors import ConfigError, DatasetError, GsError
from ..io.block_record import BlockRecord, block_name
from ..io.colmap.folder import write_model
from ..io.colmap.model import ColmapCamera, ColmapImage, ColmapModel, ColmapPoints
from ..io.files import link_or_copy, reason
from ..io.images.read_image import IMAGE_ENDINGS
from ..quoting import quoted
from ..scene import within_reach
from ..text_format import count_text
from ..transforms import rotmat_to_quat
from .block_cells import MARGIN, SHARE, Cells, make_cells, photos_per_cell, visible_points

MOST_BLOCKS = 10_000
_FEWEST_PHOTOS = 3
"""Least number of photos for a training."""


@dataclass(frozen=True, kw_only=True)
class Block:
    """One block before it is written."""

    record: BlockRecord
    """Record for its folder."""
    views: list[int]
    """Indices of its photos in `Cut.views`, ascending."""
    rows: np.ndarray
    """[Q] int64, rows of its points, ascending."""
    own_points: int
    """Number of these in its cell."""


@dataclass(frozen=True, kw_only=True)
class Cut:
    """A capture and its blocks."""

    views: list[View]
    """Views of the capture, sorted by name."""
    masks: list[Path | None]
    """Masks of the photos."""
    model: ColmapModel
    """Cameras and points; its images in the order of `views`."""
    blocks: list[Block]
    warnings: tuple[str, ...]
    """Messages for the user."""


def cut_capture(
    data: DataConfig, count: int, *, margin: float = MARGIN, share: float = SHARE
) -> Cut:
    """Select photos and points of each block.

    Args:
        data: The capture, and the rule for held-out views.
        count: Number of blocks.
        margin: Share of a cell's extent by which it is widened to select photos.
        share: Least share of a photo's visible points in the widened cell.

    Raises:
        ConfigError: a number is invalid.
        DatasetError: the capture is missing, has no points, or too few photos for `count` blocks.
        FormatError: a file of it is corrupt.
    """
    _check(count, margin, share)
    capture = read_capture(data)
    views = sorted(capture.views, key=lambda view: view.name)
    if capture.up is None:
        capture = replace(capture, up=up_from_exif(views))
    masks, mask_warnings = masks_of_views(data, capture.root, views)
    model = _model(capture, views)
    if not len(model.points):
        raise DatasetError(
            f"{data.source} has no points, which blocks are cut by. Compute some with COLMAP or "
            "gscore sfm."
        )
    cells = make_cells(
        model.points.xyz,
        np.maximum(model.points.track_lengths, 1),
        np.stack([image.viewmat for image in model.images]),
        count,
        up=capture.up,
    )
    names, stated = [view.name for view in views], capture.test_names
    by_rule = is_chosen(data, stated=stated)
    _, test, shot_warnings = warn_of_split_shots(
        views, *split_views(names, data, stated=stated), chosen=by_rule
    )
    held_out = {views[i].name for i in test}
    records = _records(cells, views, held_out, capture)
    blocks = _blocks(model, cells, records, margin, share)
    warnings = [*capture.warnings, *mask_warnings, *shot_warnings]
    return Cut(views=views, masks=masks, model=model, blocks=blocks, warnings=tuple(warnings))


def _check(count: int, margin: float, share: float) -> None:
    if not 2 <= count <= MOST_BLOCKS:
        raise ConfigError(f"The number of blocks must be 2 to {MOST_BLOCKS}, got {quoted(count)}.")
    if not 0 <= margin <= 1:
        raise ConfigError(f"margin must be 0 to 1, got {margin:g}.")
    if not 0 < share <= 1:
        raise ConfigError(f"share must be above 0 and at most 1, got {share:g}.")


def _model(capture: Capture, views: list[View]) -> ColmapModel:
    """The capture's COLMAP model with tracks, or one built from the capture; images as `views`."""
    viewmats = {view.name: view.viewmat for view in views}
    found = model_with(capture.root, viewmats, origin=capture.origin)
    if found is None:
        return _made(capture, views)
    by_name = {image.name: image for image in found.images}
    images = [replace(by_name[view.name], name=file_name(view)) for view in views]
    usable = np.flatnonzero(within_reach(found.points.xyz))
    return replace(found, images=images, points=points_at(found.points, usable), up=capture.up)


def _made(capture: Capture, views: list[View]) -> ColmapModel:
    cameras: dict[int, ColmapCamera] = {}
    known: dict[tuple, int] = {}
    images = []
    for i, view in enumerate(views):
        camera = view.camera
        key = (camera.model, camera.width, camera.height, camera.params.tobytes())
        camera_id = known.setdefault(key, len(known) + 1)
        cameras[camera_id] = camera
        images.append(
            ColmapImage(
                id=i + 1,
                name=file_name(view),
                camera_id=camera_id,
                qvec=rotmat_to_quat(view.viewmat[:3, :3]),
                tvec=view.viewmat[:3, 3],
                xys=np.zeros((0, 2)),
                point3D_ids=np.zeros(0, np.int64),
            )
        )
    xyz = capture.points.points.astype(np.float64)
    good = within_reach(xyz)
    xyz = xyz[good]
    points = ColmapPoints(
        ids=np.arange(1, len(xyz) + 1),
        xyz=xyz,
        rgb=capture.points.colors[good],
        error=np.full(len(xyz), -1.0),
        track_lengths=np.zeros(len(xyz), np.int32),
    )
    return ColmapModel(
        cameras=cameras, images=images, points=points, up=capture.up, origin=capture.origin
    )


def _records(
    cells: Cells, views: list[View], held_out: set[str], capture: Capture
) -> Callable[[int, list[int]], BlockRecord]:
    """Function that makes the record of a block from its index and views."""
    digest = hashlib.sha256(cells.axes.tobytes() + cells.bounds.tobytes())
    for view in views:
        digest.update(view.name.encode("utf-8", "surrogateescape") + b"\0")
        digest.update(view.viewmat.tobytes())
    split = digest.hexdigest()[:16]

    def record(index: int, chosen: list[int]) -> BlockRecord:
        names = [file_name(views[i]) for i in chosen if views[i].name in held_out]
        return BlockRecord(
            split=split,
            index=index,
            axes=cells.axes,
            bounds=cells.bounds,
            test_names=tuple(names),
            masks_are=capture.masks_are,
            origin=capture.origin,
        )

    return record


def _blocks(
    model: ColmapModel,
    cells: Cells,
    record: Callable[[int, list[int]], BlockRecord],
    margin: float,
    share: float,
) -> list[Block]:
    seen = visible_points(model)
    chosen = photos_per_cell(seen, cells.around(model.points.xyz, margin), share)
    inside = cells.contains(model.points.xyz)
    blocks = []
    for index, photos in enumerate(chosen):
        views = np.flatnonzero(photos).tolist()
        if len(views) < _FEWEST_PHOTOS:
            raise DatasetError(
                f"Block {index} would have {count_text(len(views), 'photo')}, too few for a "
                f"training. Cut fewer than {len(chosen)} blocks."
            )
        shown = np.zeros(len(model.points), bool)
        for i in views:
            shown[seen[i]] = True
        shown |= inside[index]
        blocks.append(
            Block(
                record=record(index, views),
                views=views,
                rows=np.flatnonzero(shown),
                own_points=int(inside[index].sum()),
            )
        )
    return blocks


def points_at(points: ColmapPoints, rows: np.ndarray) -> ColmapPoints:
    """Points at these rows [Q]."""
    return ColmapPoints(**{name: values[rows] for name, values in vars(points).items()})


def file_name(view: View) -> str:
    """Name of the view with the ending of its file."""
    pure = PurePosixPath(view.name.replace("\\", "/"))
    ending = view.image.suffix
    if pure.suffix.lower() == ending.lower():
        return pure.as_posix()
    if pure.suffix.lower() in IMAGE_ENDINGS:
        return pure.with_suffix(ending).as_posix()
    return f"{pure.as_posix()}{ending}"


def write_blocks(cut: Cut, folder: Path, on_progress: Callable[[int], object]) -> None:
    """Write all blocks into a new folder, completely or not at all.

    Args:
        cut: Result of `cut_capture`.
        folder: New or empty; `block_0`, `block_1` and so on are made in it. Photos are hard-linked,
            or copied if that is impossible.
        on_progress: Receives the number of linked photos, counted per block.

    Raises:
        ConfigError: the folder is not empty.
        GsError: it cannot be written.
    """
    check_empty(folder)
    whole = folder.resolve()
    made = whole.parent / f".{whole.name}.{os.getpid()}.split"
    done = 0
    try:
        for block in cut.blocks:
            place = made / block_name(block.record.index)
            for i in block.views:
                _fill(cut.views[i], cut.masks[i], place)
                done += 1
                on_progress(done)
            (place / "sparse/0").mkdir(parents=True)
            write_model(_part(cut.model, block), place / "sparse/0")
            block.record.write(place)
        with contextlib.suppress(FileNotFoundError):
            whole.rmdir()
        made.rename(whole)
    except OSError as error:
        raise GsError(f"Cannot write {folder}: {reason(error)}") from error
    finally:
        shutil.rmtree(made, ignore_errors=True)


def check_empty(folder: Path) -> None:
    """Raise ConfigError unless blocks may be written there."""
    taken = folder.exists() and (not folder.is_dir() or any(folder.iterdir()))
    if taken:
        raise ConfigError(f"{folder} is not empty. Choose a new folder for the blocks with -o.")


def _part(model: ColmapModel, block: Block) -> ColmapModel:
    """Model of a block; `write_model` detaches observations of points that are not in it."""
    images = [model.images[i] for i in block.views]
    used = {image.camera_id for image in images}
    cameras = {key: camera for key, camera in model.cameras.items() if key in used}
    return replace(
        model, cameras=cameras, images=images, points=points_at(model.points, block.rows)
    )


def _fill(view: View, mask: Path | None, place: Path) -> None:
    """Link a photo and its mask under the names of a COLMAP capture."""
    name = file_name(view)
    link_or_copy(view.image, place / "images" / name)
    if mask is not None:
        link_or_copy(mask, place / "masks" / f"{name}.png")
