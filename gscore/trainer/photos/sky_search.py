"""Sky search: cells of photos that show the sky, found by colour, texture and SfM points.

Photos are divided into square cells. A sky cell is above the horizon, bright and white or blue, has
little texture and no SfM points in or next to it, and most cells around it are similar. It counts
if several photos have such a cell in that direction: a white wall has another direction in each
photo.
"""

import zlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from PIL import Image

from ...config import Switch, TrainConfig
from ...events import Decision
from ...sampling import evenly_spaced, sphere
from ...scene import Cameras, PointCloud
from ...text_format import count_text, number
from ...upright import up_of
from .view_sampler import Photos

_MOST_PHOTOS = 120
"""Most photos divided into cells, evenly spaced."""
_ACROSS, _SAMPLES = 48, 4
"""Cells along the longer side of a photo, and samples along the side of a cell."""
_MOST_POINTS = 200_000
"""Most SfM points, evenly spaced by row, that are used."""
_TEXTURE = 0.035
"""Largest standard deviation of colours in a sky cell, of 1: clouds have 0.02, a far roof 0.1."""
_HORIZON = 0.02
"""Least sine of the elevation of a sky cell."""
_WHITE, _OF_WHITEST, _NEUTRAL = 0.7, 0.8, 0.93
"""Limits of a white sky: smallest channel, the same relative to the brightest cells of the photo,
and smallest ratio of blue to red, because walls in lamplight are yellow."""
_BLUE, _OF_BRIGHTEST = 1.12, 0.55
"""Limits of a blue sky: least ratio of blue to red, and blue relative to the brightest cells."""
_BRIGHTEST = 0.98
"""Quantile of brightness of the brightest cells of a photo."""
_LEAST_SIMILAR = 6
"""Least sky cells among the nine around and including one."""
_FEWEST = 3
"""Least photos with sky cells in the same direction, and least photos that show the sky."""
_DIRECTIONS = 1000
"""Number of directions distinguished in the search, 6 degrees apart."""
_AREA, _SHARE = 0.01, 0.1
"""Least area of the sky in a photo that shows it, and least share of such photos."""
_ON = Decision("sky", "A whole sphere of distant splats surrounds the scene (requested).")


@dataclass(frozen=True, kw_only=True)
class PhotoCells:
    """A photo divided into h x w square cells, without its incomplete ones."""

    side: int
    """Side of a cell, px."""
    colors: np.ndarray
    """[h, w, 3] float32, mean colours, 0 to 1."""
    texture: np.ndarray
    """[h, w] float32, standard deviation of colours, mean of the channels."""
    counted: np.ndarray
    """[h, w] bool, no masked pixel."""

    def at(self, cameras: Cameras, view: int, means: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return rows [M] of the positions `means`, [N, 3], that the photo of a view shows, and
        [M] vertical and horizontal indices of their cells."""
        viewmat = cameras.viewmats[view]
        x, y, z = cameras.Ks[view] @ (viewmat[:3, :3] @ means.T + viewmat[:3, 3:])
        rows = np.flatnonzero(z > 0)
        across, down = (np.floor(at[rows] / z[rows] / self.side) for at in (x, y))
        height, width = self.counted.shape
        inside = (across >= 0) & (across < width) & (down >= 0) & (down < height)
        return rows[inside], down[inside].astype(np.int64), across[inside].astype(np.int64)


@dataclass(frozen=True, kw_only=True)
class Sky:
    """Sky of a capture, as its photos show it."""

    cells: Mapping[int, PhotoCells]
    """Photos by view."""
    shown: Mapping[int, np.ndarray]
    """[h, w] bool, sky cells of these photos."""
    everywhere: bool = False
    """Whether the sky is a whole sphere, in the colours of all cells; else where it was found."""

    def digest(self) -> int:
        """Hash of the sky cells."""
        return zlib.crc32(b"".join(self.shown[view].tobytes() for view in sorted(self.shown)))


def sky_views(config: TrainConfig, photos: Photos) -> list[int]:
    """Return the views that a search needs; none where the options exclude a sky."""
    given = config.start_splats or config.region
    if config.sky is Switch.OFF or given or photos.mask_mode == "composite":
        return []
    return evenly_spaced(list(photos.train), _MOST_PHOTOS)


def cells_of(image: np.ndarray, mask: np.ndarray | None) -> PhotoCells:
    """Divide a photo, [H, W, 3] uint8; `mask`, [H, W] uint8, is 255 where it counts."""
    photo = Image.fromarray(image)
    step = max(1, max(photo.size) // (_ACROSS * _SAMPLES))
    samples = np.asarray(photo.reduce(step), np.float32) / 255
    height, width = (max(size // step // _SAMPLES, 1) for size in image.shape[:2])
    whole = samples[: height * _SAMPLES, : width * _SAMPLES]
    parts = whole.reshape(height, len(whole) // height, width, whole.shape[1] // width, 3)
    counted = np.ones((height, width), bool)
    if mask is not None:
        small = np.asarray(Image.fromarray(mask).reduce(step))[: len(whole), : whole.shape[1]]
        counted = (small.reshape(parts.shape[:4]) == 255).all(axis=(1, 3))
    return PhotoCells(
        side=step * _SAMPLES,
        colors=parts.mean(axis=(1, 3)),
        texture=parts.std(axis=(1, 3)).mean(axis=-1),
        counted=counted,
    )


def decide_sky(
    config: TrainConfig,
    photos: Photos,
    cells: Mapping[int, PhotoCells],
    *,
    is_part: bool,
) -> tuple[Sky | None, Decision | None]:
    """Find the sky and decide whether the training gets splats for it.

    Args:
        config: The options.
        photos: The capture.
        cells: Photos of `sky_views`.
        is_part: A block is trained, whose surroundings are other splats.
    """
    if not cells:
        return None, None
    shown = _sky_cells(photos.scene.cameras, photos.scene.points, cells)
    if config.sky is Switch.ON:
        return Sky(cells=cells, shown=shown, everywhere=True), _ON
    photos_with = sum(map.mean() >= _AREA for map in shown.values())
    if is_part or photos_with < max(_FEWEST, _SHARE * len(cells)):
        return None, None
    text = (
        f"{number(photos_with)} of {count_text(len(cells), 'photo')} show the sky, which gets "
        "distant splats behind the scene. `--sky off` trains without."
    )
    return Sky(cells=cells, shown=shown), Decision("sky", text)


def thinned(points: np.ndarray) -> np.ndarray:
    """Return at most 200,000 evenly spaced rows of `points`, [P, 3], in any frame."""
    return points[:: -(-max(len(points), 1) // _MOST_POINTS)]


def _sky_cells(
    cameras: Cameras, cloud: PointCloud, cells: Mapping[int, PhotoCells]
) -> dict[int, np.ndarray]:
    """Return [h, w] bool by view: cells that show the sky; none without SfM points, which make the
    difference to walls."""
    from scipy.spatial import KDTree

    if cloud.made_up:
        return {view: np.zeros_like(one.counted) for view, one in cells.items()}
    points = thinned(cloud.points)
    up, ahead = up_of(cameras), KDTree(sphere(_DIRECTIONS))
    similar, nearest, photos = {}, {}, np.zeros(_DIRECTIONS, np.int64)
    for view, one in cells.items():
        rays = _rays(cameras, view, one)
        similar[view] = _similar(cameras, view, one, points) & (rays @ up > _HORIZON)
        similar[view] &= _around(similar[view]) >= _LEAST_SIMILAR
        nearest[view] = ahead.query(rays[similar[view]])[1]
        photos[np.unique(nearest[view])] += 1
    shown = {}
    for view, found in similar.items():
        shown[view] = np.zeros_like(found)
        shown[view][found] = photos[nearest[view]] >= _FEWEST
    return shown


def _similar(cameras: Cameras, view: int, cells: PhotoCells, points: np.ndarray) -> np.ndarray:
    """Return [h, w] bool: cells with the colour and texture of a sky, away from points."""
    occupied = np.zeros_like(cells.counted)
    _, down, across = cells.at(cameras, view, points)
    occupied[down, across] = True
    least, red, blue = cells.colors.min(axis=-1), cells.colors[..., 0], cells.colors[..., 2]
    brightest = np.quantile(cells.colors.mean(axis=-1), _BRIGHTEST)
    is_white = (least > max(_WHITE, _OF_WHITEST * brightest)) & (blue >= _NEUTRAL * red)
    is_blue = (blue > _BLUE * red) & (blue >= cells.colors[..., 1])
    is_blue &= blue > _OF_BRIGHTEST * brightest
    smooth = (cells.texture < _TEXTURE) & cells.counted
    return smooth & (_around(occupied) == 0) & (is_white | is_blue)


def _rays(cameras: Cameras, view: int, cells: PhotoCells) -> np.ndarray:
    """Return [h, w, 3] unit vectors in the world from the camera through the middle of cells."""
    height, width = cells.counted.shape
    v, u = (np.mgrid[:height, :width] + 0.5) * cells.side
    pixels = np.stack([u, v, np.ones_like(u)], axis=-1)
    rays = pixels @ np.linalg.inv(cameras.Ks[view]).T @ cameras.viewmats[view, :3, :3]
    return rays / np.linalg.norm(rays, axis=-1, keepdims=True)


def _around(cells: np.ndarray) -> np.ndarray:
    """Return [h, w]: how many of `cells`, [h, w] bool, are true of the nine around each."""
    height, width = cells.shape
    padded = np.pad(cells.astype(np.int64), 1)
    parts = [padded[i : i + height, j : j + width] for i in range(3) for j in range(3)]
    return np.sum(parts, axis=0)
