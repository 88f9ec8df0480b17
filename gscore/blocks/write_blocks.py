"""Block writer: an ordinary capture per block, with links to the photos where possible."""

import contextlib
import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from ..datasets.capture import View
from ..errors import ConfigError, GsError
from ..io.block_record import block_name
from ..io.colmap.folder import write_model
from ..io.colmap.model import ColmapModel
from ..io.files import reason
from ..io.link_or_copy import link_or_copy
from .split_capture import Block, Cut, file_name, points_at


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
