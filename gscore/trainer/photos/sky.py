"""Sky: initial splats on a sphere around the scene.

Sky and distant hills have no SfM points, so views between the photos would be black there. Each
direction of the sphere gets the mean colour of the photos, and directions outside all photos the
mean of the nearest ones inside.
"""

from collections.abc import Sequence

import numpy as np
from PIL import Image

from ...config import TrainConfig
from ...errors import ConfigError
from ...scene import Cameras, distances
from ...sh import rgb_to_sh0
from ...splats import Splats
from .view_sampler import Photos, evenly_spaced

_SPLATS, _SHARE = 1000, 10
"""Most splats of the sphere, and its smallest divisor of `max_splats`."""
_FAR = 3.0
"""Radius in distances to the farthest camera, or to the 99th percentile of the points."""
_FEW = 0.01
_OPACITY = 0.9
_SIZE = 0.6
"""Standard deviation in distances between neighbours: the sphere then has no gaps."""
_MOST_PHOTOS = 120
"""Most photos sampled for colours, evenly spaced."""
_ACROSS = 48
"""Squares along the longer side of a photo, over which colours are averaged."""
_NEIGHBOURS = 8
"""Nearest directions averaged for a direction that no photo shows."""


def sky_splats(
    config: TrainConfig, photos: Photos, cameras: Cameras, points: np.ndarray
) -> Splats | None:
    """Return the splats of the sphere, training frame, SH degree 0; None without `sky`.

    Args:
        config: The options.
        photos: Source of the colours, from training views.
        cameras: All of `photos`, training frame.
        points: [P, 3] float64, start points, training frame.

    Raises:
        ConfigError: masks are opacity, so there is no background, or the run has a region.
        DatasetError, FormatError: a photo cannot be read.
    """
    if not config.sky:
        return None
    if photos.mask_mode == "composite" or config.region is not None:
        what = "the region" if config.region else "the masked subject (`--mask-mode composite`)"
        raise ConfigError(f"Only {what} is trained, so there is no sky: leave out `--sky`.")
    views = evenly_spaced(list(photos.train), _MOST_PHOTOS)
    middle = cameras.centers[views].mean(axis=0)
    away = distances(points, middle)
    reach = float(np.quantile(away[np.isfinite(away)], 1 - _FEW)) if np.isfinite(away).any() else 0
    radius = _FAR * max(reach, float(distances(cameras.centers[views], middle).max()))
    ahead = _directions(min(_SPLATS, config.max_splats // _SHARE))
    count = len(ahead)
    if radius == 0 or count == 0:
        return None
    means = middle + radius * ahead
    colors = _spread(*_colors(photos, cameras, views, means), ahead)
    quats = np.zeros((count, 4), np.float32)
    quats[:, 0] = 1
    size = _SIZE * radius * np.sqrt(4 * np.pi / count)
    return Splats(
        means=means.astype(np.float32),
        quats=quats,
        scales=np.full((count, 3), np.log(size), np.float32),
        opacities=np.full(count, np.log(_OPACITY / (1 - _OPACITY)), np.float32),
        sh0=rgb_to_sh0(colors)[:, None, :].astype(np.float32),
        shN=np.zeros((count, 0, 3), np.float32),
    )


def _directions(count: int) -> np.ndarray:
    """Return [count, 3] evenly distributed unit vectors, on a spiral with the golden angle."""
    place = np.arange(count)
    z, turn = 1 - (2 * place + 1) / max(count, 1), place * np.pi * (3 - np.sqrt(5))
    across = np.sqrt(1 - z * z)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)


def _colors(
    photos: Photos, cameras: Cameras, views: Sequence[int], means: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return [N, 3] mean colours, 0 to 1, of the photos that show the positions `means`, and [N]
    numbers of these photos."""
    sums, hits = np.zeros((len(means), 3)), np.zeros(len(means), int)
    for view in views:
        photo, mask = Image.fromarray(photos.image(view)), photos.mask(view)
        side = max(1, max(photo.size) // _ACROSS)
        small = np.asarray(photo.reduce(side), np.float64) / 255
        counts = np.ones(small.shape[:2], bool)
        if mask is not None:
            counts = np.asarray(Image.fromarray(mask).reduce(side)) == 255
        viewmat = cameras.viewmats[view]
        x, y, z = cameras.Ks[view] @ (viewmat[:3, :3] @ means.T + viewmat[:3, 3:])
        shown = np.flatnonzero(z > 0)
        across, down = (np.floor(at[shown] / z[shown] / side) for at in (x, y))
        shown = shown[(across >= 0) & (across < small.shape[1]) & (down >= 0) & (down < len(small))]
        across, down = (np.floor(at[shown] / z[shown] / side).astype(int) for at in (x, y))
        good = counts[down, across]
        sums[shown[good]] += small[down[good], across[good]]
        hits[shown[good]] += 1
    return sums / np.maximum(hits, 1)[:, None], hits


def _spread(colors: np.ndarray, hits: np.ndarray, ahead: np.ndarray) -> np.ndarray:
    """Return `colors`, [N, 3], where directions `ahead` in no photo (`hits` is 0) get the mean of
    the nearest ones in photos, or grey without any."""
    known, unknown = np.flatnonzero(hits), np.flatnonzero(hits == 0)
    if len(known) == 0:
        return np.full_like(colors, 0.5)
    found = colors.copy()
    cosine = ahead[unknown] @ ahead[known].T
    nearest = np.argsort(-cosine, axis=1, kind="stable")[:, :_NEIGHBOURS]
    found[unknown] = colors[known][nearest].mean(axis=1)
    return found
