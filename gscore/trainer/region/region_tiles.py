"""Region tiles: the tiles of a view that splats of the region can change."""

import numpy as np

from ...raster import native_library
from ...raster.request import Frustum
from ...shared_constants import EPS2D, JACOBIAN_MARGIN, REACH
from ..photos.image_pyramid import SizedView, tiles_of_mask


def mask_to_region(found: SizedView, means: np.ndarray, scales: np.ndarray) -> SizedView:
    """Mask a view to the tiles in which splats with these raw parameters may be drawn.

    All other pixels do not depend on these splats.
    """
    view, side = found.view, native_library.TILE
    tiles = tiles_of_splats(means, scales, view)
    shown = np.repeat(np.repeat(tiles, side, axis=0), side, axis=1) * np.uint8(255)
    mask = np.ascontiguousarray(shown[: view.height, : view.width])
    if found.mask is not None:
        np.minimum(mask, found.mask, out=mask)
    return found._replace(
        mask=mask,
        tiles=tiles_of_mask(mask),
        counted=float(mask.mean()) / 255,
    )


def tiles_of_splats(means: np.ndarray, scales: np.ndarray, view: Frustum) -> np.ndarray:
    """Return [ceil(H / 16), ceil(W / 16)] uint8, 1 where splats with means [N, 3] and log scales
    [N, 3] may be drawn, bounded by discs with the radius of the longest axis."""
    viewmat, K = (np.asarray(a, np.float64) for a in (view.viewmat, view.K))
    place = means @ viewmat[:3, :3].T + viewmat[:3, 3]
    widest = scales.max(axis=1, initial=-np.inf)
    drawn = (place[:, 2] > view.near) & np.isfinite(place).all(axis=1) & np.isfinite(widest)
    (x, y, z), sigma = place[drawn].T, np.exp(widest[drawn].astype(np.float64))
    x, y, focal = x / z, y / z, max(K[0, 0], K[1, 1])
    # Upper bound of the norm of the projection's Jacobian.
    tangents = np.minimum(np.abs(x), _most(K[0, 0], K[0, 2], view.width)) ** 2
    tangents += np.minimum(np.abs(y), _most(K[1, 1], K[1, 2], view.height)) ** 2
    radius = REACH * np.sqrt((focal / z * sigma) ** 2 * (1 + tangents) + EPS2D) + 1
    left, right = _tiles(K[0, 0] * x + K[0, 2], radius, view.width)
    top, bottom = _tiles(K[1, 1] * y + K[1, 2], radius, view.height)
    return _covered(top, bottom, left, right, (view.height, view.width))


def _most(focal: float, centre: float, size: int) -> float:
    """Largest tangent of a direction after the clamping."""
    return (max(centre, size - centre) + JACOBIAN_MARGIN * size) / focal


def _tiles(centre: np.ndarray, radius: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Return first tile and end tile of each splat along an axis, clamped to the view."""
    count = -(-size // native_library.TILE)
    first = np.clip(np.floor((centre - radius) / native_library.TILE), 0, count)
    end = np.clip(np.floor((centre + radius) / native_library.TILE) + 1, 0, count)
    return first.astype(np.int64), end.astype(np.int64)


def _covered(
    top: np.ndarray,
    bottom: np.ndarray,
    left: np.ndarray,
    right: np.ndarray,
    size: tuple[int, int],
) -> np.ndarray:
    """Return the tiles covered by any rectangle: corner counts, then cumulative sums."""
    rows, columns = (-(-n // native_library.TILE) for n in size)
    counts = np.zeros((rows + 1) * (columns + 1), np.int64)
    corners = ((top, left, 1), (bottom, right, 1), (top, right, -1), (bottom, left, -1))
    for row, column, sign in corners:
        counts += sign * np.bincount(row * (columns + 1) + column, minlength=len(counts))
    sums = counts.reshape(rows + 1, columns + 1).cumsum(axis=0).cumsum(axis=1)
    return (sums[:rows, :columns] > 0).astype(np.uint8)
