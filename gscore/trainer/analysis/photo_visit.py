"""Photo facts: EXIF exposures, track colours and masks of all photos, read in one pass."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ...choices import Background
from ...config import Switch, TrainConfig
from ...datasets import Dataset
from ...datasets.dataset import map_threads
from ...datasets.tracks import Tracks, tracks_of
from ...io.images.pillow_images import opened_picture
from ...io.images.read_image import resize
from ...shared_constants import EXPOSURE_OFFSET
from ..photos.sky_search import PhotoCells, cells_of, sky_views

_EXIF, _TIME, _APERTURE, _SPEED = 0x8769, 0x829A, 0x829D, 0x8827
"""Tags: Exif directory, exposure time in s, f-number, ISO speed."""


def stated_exposure(path: Path) -> float | None:
    """log2(time x ISO / f-number^2): brightness of the same scene in stops above an exposure of 1 s
    at ISO 1, f/1. None if EXIF lacks one of the three.

    Raises:
        DatasetError, FormatError, BackendError: as `read_info`.
    """
    with opened_picture(path) as image:
        time, aperture, speed = _stated(image)
    value = time * speed / aperture**2 if aperture > 0 else 0.0
    return math.log2(value) if 0 < value < math.inf else None


def _stated(image: Any) -> tuple[float, float, float]:
    """Time, f-number and speed; 0 for missing ones."""
    try:
        tags = image.getexif().get_ifd(_EXIF)
        return _number(tags.get(_TIME)), _number(tags.get(_APERTURE)), _number(tags.get(_SPEED))
    except Exception:  # damaged EXIF does not make the picture unusable
        return 0.0, 0.0, 0.0


def _number(value: Any) -> float:
    """EXIF value as a number, the first of several; 0 if it is none."""
    if isinstance(value, tuple | list):
        value = value[0] if value else 0
    try:
        return float(value)
    except (TypeError, ValueError, ZeroDivisionError):
        return 0.0


_SIDE = 200
"""Longer side of the downscaled photos that colours are sampled from, px: large pixels tolerate
reprojection errors."""
_DARK, _BRIGHT = 10, 245
"""Range of bytes in which a colour follows the exposure."""
_LEVELS = {Background.AUTO: 0, Background.BLACK: 0, Background.WHITE: 255}
"""Bytes of the background colours; `auto` is black without masks as opacity."""
_EQUAL = 3
"""Difference of bytes up to which a pixel has the colour of the background."""
_SHOWN = 128
"""Smallest mask byte of a valid colour."""


@dataclass(frozen=True, kw_only=True)
class TrackColors:
    """S colours of P points in V photos."""

    view: np.ndarray
    """[S] int64, 0 to V - 1: index in the measured views."""
    point: np.ndarray
    """[S] int64, row of the point."""
    log_color: np.ndarray
    """[S, 3] float64, ln of encoded R, G, B in [0, 1] + 0.055."""
    views: int
    """V."""

    def __len__(self) -> int:
        return len(self.view)


def joined_colors(found: list[tuple[np.ndarray, np.ndarray]]) -> TrackColors:
    """Join the results of `colors_in_view`, by view."""
    return TrackColors(
        view=np.repeat(np.arange(len(found)), [len(rows) for rows, _ in found]),
        point=np.concatenate([rows for rows, _ in found]),
        log_color=np.concatenate([colors for _, colors in found]),
        views=len(found),
    )


def backdrop_share(image: np.ndarray, mask: np.ndarray | None, level: int) -> float:
    """Share of the counted pixels of a photo [H, W, 3] that have one of the background colours of a
    training, `level`: 0 black, 255 white."""
    flat: np.ndarray = np.all(np.abs(image.astype(np.int16) - level) <= _EQUAL, axis=2)
    counted = flat if mask is None else flat[mask >= _SHOWN]
    return float(counted.mean()) if counted.size else 0.0


def colors_in_view(
    dataset: Dataset, tracks: Tracks, index: int, image: np.ndarray, mask: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Rows [M] of points and ln of their colours + 0.055 [M, 3], see `gscore.photo_exposure`, at
    their observations in one photo, except dark, clipped and masked ones."""
    cameras = dataset.scene.cameras
    height, width = image.shape[:2]
    small = max(1.0, max(height, width) / _SIDE)
    columns, lines = max(1, round(width / small)), max(1, round(height / small))
    rows = tracks.observed[index]
    K = cameras.Ks[index]
    pixels = tracks.rays[index] * K[[0, 1], [0, 1]] + K[:2, 2]
    pixels = pixels * (columns / width, lines / height)
    inside = ((pixels >= 0) & (pixels < (columns, lines))).all(axis=1)
    rows, (u, v) = rows[inside], pixels[inside].astype(np.int64).T
    colors = resize(image, columns, lines)[v, u]
    good = (colors.min(axis=1) >= _DARK) & (colors.max(axis=1) <= _BRIGHT)
    if mask is not None and dataset.mask_mode != "none":
        good &= resize(np.dstack([mask] * 3), columns, lines)[v, u, 0] >= _SHOWN
    return rows[good], np.log(colors[good] / 255.0 + EXPOSURE_OFFSET)


@dataclass(frozen=True, kw_only=True)
class PhotoFacts:
    """Facts of the T training photos, in their order."""

    tracks: Tracks | None = None
    """Tracks of the capture; None: unknown, or not needed."""
    brightest: list[int] = field(default_factory=list)
    """Maxima of the masks, 0 to 255; empty: masks are not used."""
    colors: TrackColors | None = None
    """Colours of the points of `tracks`; None: unknown, or not needed."""
    backdrop: float = 0.0
    """Mean share of the counted pixels that have the training's background colour; 0: not needed,
    or the background is random."""
    cells: Mapping[int, PhotoCells] = field(default_factory=dict)
    """Photos divided into cells for the search of a sky, by view; empty: not needed."""
    stops: np.ndarray | None = None
    """[V] float64, exposures of all photos by EXIF, stops; NaN: unknown for a held-out photo; None:
    not needed, or unknown for some training photo."""


def visit_photos(config: TrainConfig, photos: Dataset) -> PhotoFacts:
    """Read the facts that the options need. Each photo is decoded once, if at all.

    Args:
        config: Options `background`, `exposure`, `opaque_weight`, `refine_poses`, `sky`,
            `guide_surface` and `guide_free`.
        photos: The capture.

    Raises:
        DatasetError, FormatError: a photo or the capture's model cannot be read.
    """
    train, exposes = list(photos.train), config.exposure is not Switch.OFF
    follows = exposes or config.refine_poses is not Switch.OFF
    guided = config.guide_surface is not None or config.guide_free is not None
    tracks = tracks_of(photos) if follows or guided else None
    colored = tracks if exposes else None
    masked = photos.mask_mode != "none"

    level = _LEVELS.get(config.background)
    if not config.opaque_weight or photos.mask_mode == "composite":
        level = None

    searched = frozenset(sky_views(config, photos))

    def visit(
        index: int,
    ) -> tuple[int, float, PhotoCells | None, tuple[np.ndarray, np.ndarray] | None]:
        mask = photos.mask(index) if masked else None
        is_needed = colored is not None or level is not None or index in searched
        image = photos.image(index) if is_needed else None
        cells = None
        if index in searched and image is not None:
            cells = cells_of(image, mask)
        share = 0.0 if level is None or image is None else backdrop_share(image, mask, level)
        colors = None
        if colored is not None and image is not None:
            colors = colors_in_view(photos, colored, index, image, mask)
        return 255 if mask is None else int(mask.max()), share, cells, colors

    needed = masked or colored or level is not None or searched
    seen = list(map_threads(visit, train, threads=config.threads)) if needed else []
    return PhotoFacts(
        tracks=tracks,
        brightest=[brightest for brightest, *_ in seen] if masked else [],
        colors=joined_colors([one for *_, one in seen if one is not None]) if colored else None,
        backdrop=float(np.mean([share for _, share, *_ in seen])) if seen else 0.0,
        cells={
            view: one for view, (_, _, one, _) in zip(train, seen, strict=True) if one is not None
        }
        if seen
        else {},
        stops=_stated_stops(photos, train, config.threads) if exposes else None,
    )


def _stated_stops(photos: Dataset, train: list[int], threads: int) -> np.ndarray | None:
    """Exposures by EXIF, see `PhotoFacts.stops`."""
    files = [one.image for one in photos.files]
    if not train or stated_exposure(files[train[0]]) is None:
        return None
    stops = np.array([*map_threads(stated_exposure, files, threads=threads)], np.float64)
    return stops if np.isfinite(stops[train]).all() else None
