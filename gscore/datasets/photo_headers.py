"""Photo headers: sizes and camera data of a capture's photos, without decoding."""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import DatasetError, GsError
from ..io.files import open_regular
from ..io.images.image_header import ImageInfo
from ..io.images.read_image import read_info
from ..quoting import first_few
from ..text_format import count_text
from ..upright import find_up
from .capture import View


@dataclass(frozen=True, kw_only=True)
class PhotoFit:
    """Match of photos with their cameras."""

    upright: tuple[bool, ...]
    """True if the camera was calibrated on the photo with its EXIF orientation applied."""
    sizes: tuple[tuple[int, int], ...]
    """Width and height of each photo in its camera's orientation, pixels."""
    misfits: tuple[int, ...]
    """Indices of photos that match their cameras in neither orientation."""


def fit_photos(views: Sequence[View], infos: Sequence[ImageInfo]) -> PhotoFit:
    """Compare photos with their cameras.

    Args:
        views: Views with the cameras.
        infos: Headers of their photos.
    """
    upright, misfits = [], []
    for i, (view, info) in enumerate(zip(views, infos, strict=True)):
        stored = view.fits(info.width, info.height)
        turned = info.is_sideways and view.fits(info.height, info.width)
        upright.append(turned and not stored)
        if not stored and not turned:
            misfits.append(i)
    sizes = [
        (info.height, info.width) if turn else (info.width, info.height)
        for info, turn in zip(infos, upright, strict=True)
    ]
    return PhotoFit(upright=tuple(upright), sizes=tuple(sizes), misfits=tuple(misfits))


def up_from_exif(
    views: Sequence[View], infos: Sequence[ImageInfo] | None = None
) -> np.ndarray | None:
    """Up direction from cameras and EXIF orientations.

    Args:
        views: Views with the cameras.
        infos: Headers of their photos; None: read here, where a missing or unreadable photo counts
            as one without EXIF orientation.

    Returns:
        [3] float64, unit, world; None if no photo has an EXIF rotation, so that only the cameras
        can state it.
    """
    infos = [_info(view) for view in views] if infos is None else infos
    turned = fit_photos(views, infos).upright
    turns = [1 if done else info.orientation for info, done in zip(infos, turned, strict=True)]
    return find_up(np.stack([view.viewmat for view in views]), turns) if set(turns) - {1} else None


def _info(view: View) -> ImageInfo:
    try:
        return read_info(view.image)
    except GsError:
        return ImageInfo(view.camera.width, view.camera.height, False)


def check_fit(views: Sequence[View], infos: Sequence[ImageInfo], fit: PhotoFit) -> None:
    """Raise DatasetError if a photo matches its camera neither as stored nor rotated by EXIF."""
    if not fit.misfits:
        return
    view, info = views[fit.misfits[0]], infos[fit.misfits[0]]
    rest = len(fit.misfits) - 1
    others = f" {count_text(rest, 'other does', 'others do')} not fit either." if rest else ""
    raise DatasetError(
        f"{view.image} is {info.width} x {info.height} pixels, its camera was calibrated for "
        f"{view.camera.width} x {view.camera.height}.{others} Give the folder of the photos that "
        f"COLMAP was run on with `--images`, or photos scaled without cropping."
    )


def photo_warnings(
    views: Sequence[View],
    infos: Sequence[ImageInfo],
    fit: PhotoFit,
    cancelled: Callable[[], bool] = lambda: False,
) -> list[str]:
    """Warnings about photos that are used in an unexpected way.

    Args:
        views, infos: As for `fit_photos`.
        fit: Its result; misfits are not reported here.
        cancelled: Called between photos; True ends the call early.
    """
    warnings = [*_copies(views, cancelled), *_flipped(views, infos, fit)]
    return warnings + _other_sizes(views, fit)


def _copies(views: Sequence[View], cancelled: Callable[[], bool]) -> list[str]:
    """Warning about copies of photos: one of the two poses must be wrong."""
    pairs = find_duplicates([view.image for view in views], cancelled)
    if not pairs:
        return []
    named = [f"{views[copy].name} of {views[first].name}" for first, copy in pairs]
    return [
        f"{count_text(len(pairs), 'photo is a copy', 'photos are copies')} of others: "
        f"{first_few(named, 3)}. Copies count twice, and a test view that is a "
        f"copy of a training view does not test anything; remove them."
    ]


def _flipped(views: Sequence[View], infos: Sequence[ImageInfo], fit: PhotoFit) -> list[str]:
    """Warning about photos that are upside down, mirrored, or square and on their side: their size
    does not show whether they were calibrated with the EXIF orientation applied."""
    unsure = [
        view.name
        for view, info, turned in zip(views, infos, fit.upright, strict=True)
        if not turned
        and (info.is_flipped or (info.is_sideways and view.fits(info.height, info.width)))
    ]
    if not unsure:
        return []
    return [
        f"The EXIF rotation of {count_text(len(unsure), 'photo')} is ignored, as in COLMAP: "
        f"{first_few(unsure)}. If the cameras were made from rotated photos, save the photos "
        "rotated."
    ]


def _other_sizes(views: Sequence[View], fit: PhotoFit) -> list[str]:
    other = [
        f"{view.name} ({size[0]} x {size[1]} for {view.camera.width} x {view.camera.height})"
        for i, (view, size) in enumerate(zip(views, fit.sizes, strict=True))
        if size != (view.camera.width, view.camera.height) and i not in fit.misfits
    ]
    if not other:
        return []
    return [
        f"{count_text(len(other), 'photo has', 'photos have')} another size than the camera; "
        f"intrinsics are scaled by the actual ratio: {first_few(other, 2)}."
    ]


_PIECE = 1 << 16
"""Bytes compared at the beginning, middle and end of files of equal size."""


def find_duplicates(paths: list[Path], cancelled: Callable[[], bool]) -> list[tuple[int, int]]:
    """Pairs of indices, first photo and copy; unreadable files are skipped.

    Files of equal size are compared by three pieces, which is enough for compressed photos.
    """
    by_size: dict[int, list[int]] = {}
    for i, path in enumerate(paths):
        by_size.setdefault(_size(path), []).append(i)
    pairs = []
    for size, candidates in by_size.items():
        known: dict[bytes, int] = {}
        for i in candidates if len(candidates) > 1 and size > 0 else ():
            if cancelled():
                return []
            with contextlib.suppress(OSError):
                first = known.setdefault(_sampled_bytes(paths[i], size), i)
                if first != i:
                    pairs.append((first, i))
    return sorted(pairs)


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0


def _sampled_bytes(path: Path, size: int) -> bytes:
    with open_regular(path) as file:
        out = file.read(_PIECE)
        for at in (size // 2, max(0, size - _PIECE)):
            file.seek(at)
            out += file.read(_PIECE)
    return out
