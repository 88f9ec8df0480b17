"""Sky: initial splats on a sphere around everything that the photos show.

Where photos look past everything, at a sky or at hills, no point of structure from motion stands,
and nothing makes a view between the photos show more than black. The sphere has in each direction
the colour that photos have there, and elsewhere that of the nearest directions that one has.
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
"""How many, at most, and no more than one in so many of `max_splats`."""
_FAR = 3.0
"""Radius in distances to the farthest camera, or to the point that few are farther than."""
_FEW = 0.01
_OPACITY = 0.9
_SIZE = 0.6
"""Standard deviation in distances between neighbours: the sphere then has no gaps."""
_MOST_PHOTOS = 120
"""Photos that are asked for their colours; of more, this many at even distances."""
_ACROSS = 48
"""Colours are means over squares, of which so many lie side by side in a photo."""
_NEIGHBOURS = 8
"""Directions whose mean one gets that no photo shows."""


def sky_splats(
    config: TrainConfig, photos: Photos, cameras: Cameras, points: np.ndarray
) -> Splats | None:
    """The splats of the sphere, training world, SH degree 0.

    Args:
        config: How to train; None is found unless `sky` asks for it.
        photos: Colours are those of the training views.
        cameras: All of `photos`, training world.
        points: [P, 3] float64, those that the run starts from, training world.

    Raises:
        ConfigError: masks are opacity, so that there is no background, or a region says what alone
            counts.
        DatasetError, FormatError: a photo cannot be had.
    """
    if not config.sky:
        return None
    if photos.mask_mode == "composite" or config.region is not None:
        what = "the region" if config.region else "what the masks show (--mask-mode composite)"
        raise ConfigError(f"Nothing but {what} is trained, so there is no sky: leave out --sky.")
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
    """[count, 3] unit: evenly over the sphere, along a spiral that turns by the golden angle."""
    place = np.arange(count)
    z, turn = 1 - (2 * place + 1) / max(count, 1), place * np.pi * (3 - np.sqrt(5))
    across = np.sqrt(1 - z * z)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)


def _colors(
    photos: Photos, cameras: Cameras, views: Sequence[int], means: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """[N, 3]: mean colour, 0 to 1, of the photos that show the places `means`; [N] how many do."""
    sums, seen = np.zeros((len(means), 3)), np.zeros(len(means), int)
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
        seen[shown[good]] += 1
    return sums / np.maximum(seen, 1)[:, None], seen


def _spread(colors: np.ndarray, seen: np.ndarray, ahead: np.ndarray) -> np.ndarray:
    """[N, 3] `colors`; of directions `ahead` that are not `seen`, the mean of the nearest that
    are, and grey where none is."""
    known, unknown = np.flatnonzero(seen), np.flatnonzero(seen == 0)
    if len(known) == 0:
        return np.full_like(colors, 0.5)
    found = colors.copy()
    alike = ahead[unknown] @ ahead[known].T
    nearest = np.argsort(-alike, axis=1, kind="stable")[:, :_NEIGHBOURS]
    found[unknown] = colors[known][nearest].mean(axis=1)
    return found
