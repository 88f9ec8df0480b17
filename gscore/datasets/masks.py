"""Masks of a capture: their folder, their files, their mode and their meaning."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..config import DataConfig
from ..errors import Cancelled, DatasetError
from ..io.images.read_image import (
    ImageInfo,
    is_scaled,
    mask_assumption,
    read_image,
    read_info,
    read_mask,
)
from ..quoting import first_few
from ..text_format import count_text, number
from .capture import Capture, View
from .dataset import map_threads
from .folder import Folder

MASK_FOLDER = "masks"
"""Folder for written masks, and the default to read them from."""
_FOLDERS = (MASK_FOLDER, "mask")
_HALF = 128
"""Alpha counts as opaque if no pixel of any photo is below this: encoders leave 254, and mattes
have fully transparent pixels."""


@dataclass(frozen=True, kw_only=True)
class MaskChoice:
    """The mask of every view."""

    mode: str
    """`composite`, `ignore` or `none`."""
    files: list[Path | None]
    """[C] mask files."""
    use_alpha: list[bool]
    """[C] whether the photo's own alpha is the mask."""
    warnings: tuple[str, ...] = ()
    """Messages for the user."""


def choose_masks(
    config: DataConfig,
    capture: Capture,
    views: list[View],
    infos: list[ImageInfo],
    sizes: Sequence[tuple[int, int]],
    *,
    cancelled: Callable[[], bool] = lambda: False,
) -> MaskChoice:
    """Find the masks: those stated by the capture, else those of a folder, else the photos' alpha.

    Alpha is a mask only if some pixel is less than half opaque. To check that, photos with alpha
    are decoded until one has such a pixel, usually the first.

    Args:
        config: Options `masks`, `mask_mode` and `invert_masks`.
        capture: The capture, for its folder and the meaning of its masks.
        views: Its views, in the order of the lists below.
        infos: Headers of their photos.
        sizes: Width and height of the photos as used; masks must have the same size, or a larger
            one of the same aspect ratio.
        cancelled: Called between photos; True stops the call.

    Raises:
        Cancelled: `cancelled` returned True.
        DatasetError: the folder is missing or has no mask of any view, or a mask has another size.
        FormatError: the first mask or a photo with alpha is corrupt.
    """
    none = MaskChoice(mode="none", files=[None] * len(views), use_alpha=[False] * len(views))
    if config.mask_mode == "none":
        return none
    files, warnings = masks_of_views(config, capture.root, views)
    existing = [file for file in files if file is not None]
    if existing:
        for view, file, size in zip(views, files, sizes, strict=True):
            if file is not None:
                check_mask_size(view, file, size)
        warnings += _assumed(existing[0])
        mode = config.mask_mode
        if mode == "auto":
            mode = capture.masks_are or _meaning(existing, inverted=config.invert_masks)
        return MaskChoice(
            mode=mode, files=files, use_alpha=none.use_alpha, warnings=tuple(warnings)
        )
    if config.invert_masks:
        warnings = [*warnings, "There are no mask files, so invert_masks changes nothing."]
    use_alpha = [info.has_alpha for info in infos]
    with_alpha = [view.image for view, used in zip(views, use_alpha, strict=True) if used]
    if not _hide_something(with_alpha, cancelled):
        if config.mask_mode != "auto":
            warnings = [
                *warnings,
                f"`--mask-mode {config.mask_mode}` changes nothing: there are no mask files, and "
                "no photo has transparent pixels.",
            ]
        return replace(none, warnings=tuple(warnings))
    mode = "composite" if config.mask_mode == "auto" else config.mask_mode
    return MaskChoice(mode=mode, files=files, use_alpha=use_alpha, warnings=tuple(warnings))


def _meaning(masks: list[Path], *, inverted: bool) -> str:
    mattes = are_mattes(len(masks), lambda i: read_mask(masks[i], inverted=inverted))
    return "composite" if mattes else "ignore"


def _hide_something(photos: list[Path], cancelled: Callable[[], bool]) -> bool:
    """True if any of these photos has a pixel that is less than half opaque."""

    def hides(i: int) -> bool:
        if cancelled():
            raise Cancelled("Reading the photos was stopped.")
        return bool((read_image(photos[i])[..., 3:] < _HALF).any())

    # The first one alone, because usually one is enough.
    rest = map_threads(hides, list(range(1, len(photos))))
    return bool(photos) and (hides(0) or any(rest))


def _assumed(mask: Path) -> list[str]:
    """Warning if the white value of masks had to be guessed, from the first mask."""
    assumed = mask_assumption(mask)
    return [f"The masks {assumed}, for example {mask}."] if assumed else []


def masks_of_views(
    config: DataConfig, root: Path, views: list[View]
) -> tuple[list[Path | None], list[str]]:
    """Mask file of each view, and warnings about views without one.

    Args:
        config: Option `masks`.
        root: Folder of the capture.
        views: Views of the capture.

    Raises:
        DatasetError: the folder is missing, or there is no mask of any view.
    """
    stated = [view.mask for view in views]
    place = root / config.masks if config.masks else masks_inside(root)
    if any(file is not None for file in stated) and not config.masks:
        files = [file if file is not None and file.is_file() else None for file in stated]
        if not any(files):
            raise DatasetError(
                f"None of the {number(len(views))} masks stated by the capture exists, "
                "for example "
                f"{next(file for file in stated if file is not None)}. Put them there, or choose "
                f"`--mask-mode none`."
            )
        where = "the paths stated by the capture"
    elif place is not None and place.is_dir():
        folder = Folder(place)
        files = folder.find_masks([view.name for view in views])
        where = str(place)
        if not any(files):
            problem = (
                f"{place} has no mask of any view ({count_text(len(folder), 'image')} there); "
                f"expected names like {views[0].name}.png."
            )
            if config.masks:
                raise DatasetError(f"{problem} Rename them, or give another folder with `--masks`.")
            return files, [f"{problem} It is not used."]
    elif config.masks:
        raise DatasetError(f"There is no mask folder {place}. Give its name with `--masks`.")
    else:
        return [None] * len(views), []
    missing = [view.name for view, file in zip(views, files, strict=True) if file is None]
    if missing:
        return files, [
            f"{len(missing)} of {count_text(len(views), 'view')} have no mask in {where}: "
            f"{first_few(missing)}; all of their pixels count."
        ]
    return files, []


def masks_inside(root: Path) -> Path | None:
    """The folder of masks in a folder, its name in any case; None: no such folder."""
    exact = next((root / name for name in _FOLDERS if (root / name).is_dir()), None)
    if exact is not None or not root.is_dir():
        return exact
    named = sorted(path for path in root.iterdir() if path.name.lower() in _FOLDERS)
    return next((path for path in named if path.is_dir()), None)


def check_mask_size(view: View, file: Path, size: tuple[int, int]) -> None:
    """Raise DatasetError unless a mask has its photo's size, or a larger size of the same aspect
    ratio."""
    info = read_info(file)
    own = (info.width, info.height)
    if own != size and not is_scaled(own, size):
        raise DatasetError(
            f"The mask {file} is {info.width} x {info.height} pixels, its photo {view.image} is "
            f"{size[0]} x {size[1]}. Scale the masks to the size of the photos, or "
            "give those of the unscaled photos."
        )


_SAMPLED = 12
"""Most masks that are read, spread over the views."""
_KEPT = 0.7
"""Share of the photo that a subject covers at most."""
_KEPT_RIM = 0.25
"""Share of the rim that it covers at most, because a matte hides the surroundings."""
_RIM = 0.02
"""Width of the rim, as a share of the shorter side."""


def are_mattes(count: int, mask: Callable[[int], np.ndarray]) -> bool:
    """True if masks cut a subject out of its surroundings.

    Such masks hide most of the rim of most photos. Masks of passers-by, a tripod or the sky keep
    most of it; masks of a lens are equal for most photos.

    Args:
        count: Number of masks, at least one.
        mask: Returns mask i, [H, W] uint8, 255 = keep; called for some of them. Its errors are
            passed on.
    """
    sample = [mask(i) for i in range(0, count, -(-count // _SAMPLED))]
    most_equal = max(Counter(each.tobytes() for each in sample).values())
    if most_equal > max(len(sample) / 2, 1):
        return False
    kept = np.median([each.mean() for each in sample]) / 255
    rim = np.median([_rim(each).mean() for each in sample]) / 255
    return bool(kept < _KEPT and rim < _KEPT_RIM)


def _rim(mask: np.ndarray) -> np.ndarray:
    """Pixels near the border of `mask` [H, W], flattened."""
    width = max(round(_RIM * min(mask.shape)), 1)
    inside = mask[width:-width]
    sides = (mask[:width], mask[-width:], inside[:, :width], inside[:, -width:])
    return np.concatenate([side.ravel() for side in sides])
