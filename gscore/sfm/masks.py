"""SfM masks in COLMAP's format: no features where they are black."""

from collections.abc import Callable, Sequence
from pathlib import Path

from ..datasets.folder import Folder, masks_by_photos
from ..errors import Cancelled, DatasetError
from ..io.images.png import write_png
from ..io.images.read_image import is_scaled, read_mask, resize_mask
from ..text_format import count_text
from .photos import Photo


def find_masks(folder: Path | None, root: Path, names: Sequence[str]) -> dict[str, Path]:
    """Mask files by the names of their photos below `root`: those in their folder, else those next
    to the photos."""
    if folder is None:
        found = masks_by_photos([root / name for name in names])
    else:
        there = Folder(folder)
        found = [there.find_mask(name) for name in names]
    pairs = zip(names, found, strict=True)
    return {name: path for name, path in pairs if path is not None}


def write_masks(
    masks: dict[str, Path],
    photos: list[Photo],
    target: Path,
    *,
    inverted: bool,
    cancelled: Callable[[], bool],
) -> list[str]:
    """Write `target`/ALIAS.png for each mask, white where features are extracted.

    Returns:
        Sentences on photos without a mask.

    Raises:
        DatasetError: a mask has another size than its photo.
        FormatError: a mask cannot be read.
        Cancelled: `cancelled` returned True.
    """
    for photo in photos:
        if photo.name not in masks:
            continue
        if cancelled():
            raise Cancelled("Reading the masks was stopped.")
        mask = read_mask(masks[photo.name], inverted=inverted)
        if is_scaled((mask.shape[1], mask.shape[0]), (photo.width, photo.height)):
            mask = resize_mask(mask, photo.width, photo.height)
        if mask.shape != (photo.height, photo.width):
            raise DatasetError(
                f"The mask {masks[photo.name]} is {mask.shape[1]} x {mask.shape[0]} pixels, its "
                f"photo {photo.name} is {photo.width} x {photo.height}. Scale the mask, or leave "
                "masks out with `--no-masks`."
            )
        write_png(target / f"{photo.alias}.png", mask)
    without = len(photos) - len(masks)
    if not without:
        return []
    return [f"{count_text(without, 'photo has', 'photos have')} no mask: all pixels count."]
