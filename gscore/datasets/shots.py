"""Shots with several files: HEIC and JPEG of one exposure, or a photo saved twice."""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import GsError
from ..io.images.image_header import ORIENTATION
from ..io.images.pillow_images import opened_picture, pillow
from ..io.images.read_image import TURNS
from ..quoting import first_few
from ..scene import camera_centers
from ..text_format import count_text
from .capture import View
from .dataset import map_threads

_SIDE = 64
"""Side of the compared thumbnails, pixels."""
_EQUAL, _SIMILAR = 2.0, 6.0
"""Largest RMS difference, of 255, of equal photos, and of similar ones of one moment. A photo saved
again at half its size differs by at most 0.8, neighbours of an orbit by 6 and more."""
_FLAT, _LEAST = 0.15, 1.0
"""Largest RMS difference as a share of the contrast, for flat photos, and the contrast below which
photos are not compared."""
_TURNED, _MOVED = np.radians(2), 0.02
"""Largest rotation, radians, and distance between cameras of one shot, as a share of the cameras'
median distance from their middle."""
_EXIF_BLOCK, _TIME, _FRACTION = 0x8769, 0x9003, 0x9291
_MAKE, _MODEL = 0x010F, 0x0110


@dataclass(frozen=True, eq=False)
class Shot:
    """Features that identify photos of one exposure."""

    pixels: np.ndarray
    """[64 * 64] float32 grey, upright."""
    moment: tuple[str, ...]
    """Time of the exposure and camera from EXIF; empty: not stated."""
    stem: str
    """Path without the ending, lower case."""


def shot_of(name: str, image: Any) -> Shot:
    """Compute the features of a photo.

    Args:
        name: Its path below the folder of the photos, with '/'.
        image: The photo, opened by Pillow.
    """
    image.draft(
        "L", (2 * _SIDE, 2 * _SIDE)
    )  # decode a JPEG at down to an eighth; loaded ones are unchanged
    upright = image.convert("L").resize((_SIDE, _SIDE), pillow().Resampling.BILINEAR)
    with contextlib.suppress(Exception):  # damaged EXIF does not make the picture unusable
        if turn := TURNS.get(image.getexif().get(ORIENTATION, 1)):
            upright = upright.transpose(pillow().Transpose[turn])
    return Shot(np.asarray(upright, np.float32).ravel(), moment_of(image), stem_of(name))


def moment_of(image: Any) -> tuple[str, ...]:
    """`Shot.moment` of Pillow's image."""
    with contextlib.suppress(Exception):  # damaged EXIF does not make the picture unusable
        exif = image.getexif()
        block = exif.get_ifd(_EXIF_BLOCK)
        if time := block.get(_TIME):
            tags = (time, block.get(_FRACTION), exif.get(_MAKE), exif.get(_MODEL))
            return tuple(str(tag).strip("\0 ") for tag in tags)
    return ()


def stem_of(name: str) -> str:
    """`Shot.stem` of a photo."""
    return name.rpartition(".")[0].lower()


def same_shots(shot: Shot, others: Sequence[Shot]) -> np.ndarray:
    """Mask [N] bool of the others that are of the same exposure as a photo: those with equal
    pixels, and similar ones of the same moment and camera.

    The moment alone would also match synchronised cameras, and bursts within a second.
    """
    if not others:
        return np.zeros(0, bool)
    pixels = np.stack([other.pixels for other in others])
    away = np.sqrt(np.mean((pixels - shot.pixels) ** 2, axis=1))
    contrast = float(shot.pixels.std())
    equal = (away <= min(_EQUAL, _FLAT * contrast)) & (contrast >= _LEAST)
    moment = np.array([bool(shot.moment) and shot.moment == other.moment for other in others])
    stem = np.array([shot.stem == other.stem for other in others])
    return equal | (moment & (stem | (away <= _SIMILAR)))


def repeats(shots: Sequence[Shot]) -> list[tuple[int, int]]:
    """Pairs of indices, the first photo of an exposure and a later one, sorted by the latter."""
    light = np.array([shot.pixels.mean() for shot in shots])
    order = np.argsort(light, kind="stable")
    rising = light[order]
    by_moment: dict[tuple[str, ...], list[int]] = {}
    first: list[int] = []
    for i, shot in enumerate(shots):
        low, high = np.searchsorted(rising, (light[i] - _EQUAL, light[i] + _EQUAL))
        similar = {j for j in order[low : high + 1].tolist() if j < i}
        near = sorted(similar.union(by_moment.get(shot.moment, ())))
        same = np.flatnonzero(same_shots(shot, [shots[j] for j in near]))
        first.append(first[near[int(same[0])]] if len(same) else i)
        if shot.moment:
            by_moment.setdefault(shot.moment, []).append(i)
    return [(one, i) for i, one in enumerate(first) if one != i]


def warn_of_split_shots(
    views: Sequence[View], train: list[int], test: list[int], *, chosen: bool
) -> tuple[list[int], list[int], list[str]]:
    """Move training views that show the same shot as a test view to the test views.

    Photos of a training and a test camera with nearly equal poses are decoded at low resolution.

    Args:
        views: All views.
        train, test: Indices, each ascending.
        chosen: Whether a rule chose the test views; a stated split is kept.

    Returns:
        Training views and test views, both ascending, and a warning about such photos.
    """
    pairs = _in_one_place(views, train, test)
    at = sorted({i for pair in pairs for i in pair})
    shots = dict(zip(at, map_threads(lambda i: _shot(views[i]), at), strict=True))
    twins: dict[int, int] = {}
    for i, j in pairs:
        one, other = shots[i], shots[j]
        if one and other and same_shots(one, [other]).any():
            twins.setdefault(i, j)
    if not twins:
        return train, test, []
    named = first_few([f"{views[i].name} of {views[j].name}" for i, j in twins.items()], 3)
    what = count_text(len(twins), "training photo shows", "training photos show")
    shown = f"{what} the same picture as a test view: {named}."
    if not chosen or len(twins) == len(train):
        return (
            train,
            test,
            [f"{shown} Metrics of such views do not measure new views; remove them."],
        )
    left = [i for i in train if i not in twins]
    return left, sorted([*test, *twins]), [f"{shown} They are test views too."]


def _in_one_place(
    views: Sequence[View], train: Sequence[int], test: Sequence[int]
) -> list[tuple[int, int]]:
    """Pairs of a training and a test view with nearly equal camera poses."""
    viewmats = np.stack([view.viewmat for view in views])
    turns = viewmats[:, :3, :3]
    centers = camera_centers(viewmats)
    spread = np.median(np.linalg.norm(centers - np.median(centers, axis=0), axis=1))
    pairs = []
    for j in test:
        moved = np.linalg.norm(centers[train] - centers[j], axis=1)
        cosine = (np.einsum("nij,ij->n", turns[train], turns[j]) - 1) / 2
        near = (moved <= _MOVED * spread) & (cosine >= np.cos(_TURNED))
        pairs += [(i, j) for i, close in zip(train, near, strict=True) if close]
    return pairs


def _shot(view: View) -> Shot | None:
    """Features of a view's photo; None if it cannot be read, which decoding it reports."""
    try:
        with opened_picture(view.image) as image:
            return shot_of(view.name, image)
    except GsError:
        return None
