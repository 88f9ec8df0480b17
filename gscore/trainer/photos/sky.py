"""Sky: initial splats on a distant sphere.

Sky and distant hills have no SfM points, so views between the photos would be black there. Each
direction gets the mean colour of the photos, and directions outside all photos the mean of the
nearest ones inside.
"""

import numpy as np

from ...config import TrainConfig
from ...errors import ConfigError
from ...sampling import sphere
from ...scene import Cameras, distances
from ...sh import rgb_to_sh0
from ...splats import Splats
from .sky_search import Sky
from .view_sampler import Photos

_SPLATS, _SHARE = 1000, 10
"""Most splats of the sphere, and its smallest divisor of `max_splats`."""
_FAR = 8.0
"""Radius in distances to the farthest camera, or to the 99th percentile of the points: ground that
reaches the horizon is seen up to three of them."""
_FEW = 0.01
_OPACITY = 0.9
_SIZE = 0.6
"""Standard deviation in distances between neighbours: the sphere then has no gaps."""
_MARGIN = np.cos(np.radians(12))
"""Cosine between a direction and a sky cell up to which it belongs to the sky: views between the
photos show a bit more of it."""
BEYOND = 0.26
"""Distance from the middle, in radii of the sphere, beyond which splats belong to the sky."""
_LEAST = 10
"""Least number of opaque splats beyond it of a model with a sky."""
_NEIGHBOURS = 8
"""Nearest directions averaged for a direction that no photo shows."""


def check_sky(photos: Photos, *, region: bool) -> None:
    """Raise ConfigError if the whole sphere is requested and masks are opacity, so that there is no
    background, or the run has a region."""
    if photos.mask_mode == "composite" or region:
        what = "the region" if region else "the masked subject (`--mask-mode composite`)"
        raise ConfigError(f"Only {what} is trained, so there is no sky: leave out `--sky on`.")


def sky_radius(cameras: Cameras, views: list[int], points: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the middle [3] and the radius of the sphere, in the frame of `cameras`.

    Args:
        cameras: Cameras of the capture.
        views: Training views.
        points: [P, 3] float64, SfM points.
    """
    middle = cameras.centers[views].mean(axis=0)
    away = distances(points, middle)
    reach = float(np.quantile(away[np.isfinite(away)], 1 - _FEW)) if np.isfinite(away).any() else 0
    return middle, _FAR * max(reach, float(distances(cameras.centers[views], middle).max()))


def has_sky(splats: Splats, cameras: Cameras, views: list[int], points: np.ndarray) -> bool:
    """Return whether given splats include a sky, or another background as far away; the other
    arguments are those of `sky_radius`, in the world of the splats."""
    middle, radius = sky_radius(cameras, views, points)
    opaque = splats.means[splats.opacities > 0]
    return int((distances(opaque, middle) > BEYOND * radius).sum()) >= _LEAST


def sky_splats(
    config: TrainConfig, sky: Sky, cameras: Cameras, middle: np.ndarray, radius: float
) -> Splats | None:
    """Return the splats of the sky, training frame, SH degree 0; None: the scene has no size.

    Args:
        config: The options.
        sky: The sky of the capture.
        cameras: All cameras, training frame.
        middle: [3] float64 centre of the sphere.
        radius: Its radius.
    """
    count = min(_SPLATS, config.max_splats // _SHARE)
    ahead = sphere(count)
    if radius == 0 or count == 0:
        return None
    colors, hits = _colors(sky, cameras, middle + radius * ahead)
    if not sky.everywhere:
        near = ((ahead @ ahead[hits > 0].T) >= _MARGIN).any(axis=1)
        ahead, colors, hits = ahead[near], colors[near], hits[near]
    quats = np.zeros((len(ahead), 4), np.float32)
    quats[:, 0] = 1
    size = _SIZE * radius * np.sqrt(4 * np.pi / count)
    return Splats(
        means=(middle + radius * ahead).astype(np.float32),
        quats=quats,
        scales=np.full((len(ahead), 3), np.log(size), np.float32),
        opacities=np.full(len(ahead), np.log(_OPACITY / (1 - _OPACITY)), np.float32),
        sh0=rgb_to_sh0(_spread(colors, hits, ahead))[:, None, :].astype(np.float32),
        shN=np.zeros((len(ahead), 0, 3), np.float32),
    )


def _colors(sky: Sky, cameras: Cameras, means: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return [N, 3] mean colours, 0 to 1, of the photos that show the positions `means`, and [N]
    numbers of these photos; of the sky cells alone unless it is everywhere."""
    sums, hits = np.zeros((len(means), 3)), np.zeros(len(means), int)
    for view, cells in sky.cells.items():
        rows, down, across = cells.at(cameras, view, means)
        good = (cells.counted if sky.everywhere else sky.shown[view])[down, across]
        sums[rows[good]] += cells.colors[down[good], across[good]]
        hits[rows[good]] += 1
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
