"""Transient search: parts of training photos that show what other photos do not show there: people,
cars, the shadow of the photographer.

A render cannot show what only one photo shows without showing it to others, so it differs from
that photo; and the surfaces that the render shows there agree with the other photos. What is found
is masked in that photo, so that it leaves no traces in the splats. The idea of masks from residuals
is that of RobustNeRF (Sabour et al. 2023) and SpotLessSplats (2024); here depths of the model tell
whether the other photos agree.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch.nn.functional import adaptive_avg_pool2d

from ...camera_neighbours import LARGEST_TURN
from ...datasets.resolution import scale_intrinsics
from ...io.images.read_image import resize
from ...raster.blur import blur_image
from ...raster.request import Frustum

MOST_CELLS = 160
"""Longer side of the maps and masks, cells."""
_SMOOTH = 2.7
"""Standard deviation of the Gaussian that smooths differences, cells: fine detail that the model
lacks cancels out."""
_DIFFERENT = 0.12
"""Smoothed difference of render and photo of a cell that is masked."""
_COMMON, _OFTEN = 0.9, 2.5
"""Quantile of the differences of all photos, and its multiple that a cell must also exceed: where
the model is still rough, large differences tell nothing."""
_LOWER = 0.5
"""Share of these limits that connected cells must exceed to be masked too."""
_TIMES, _LOWER_TIMES = 3.0, 2.0
"""Multiples of the median difference of the other photos at the same surface above which they
are."""
_OTHERS, _NEAREST = 3, 12
"""Fewest of the nearest photos that must show the same surface."""
_SAME_DEPTH = 0.1
"""Largest difference of depths of one surface, relative."""
_SMALLEST, _LARGEST = 0.001, 0.7
"""Shares of a photo: of its smallest connected part, and of all above which nothing is masked: its
camera or light is another."""
_WIDER = 2
"""Cells by which what is found grows, as smoothing narrows it."""
_NEAR_EDGE = 4
"""Cells around an edge of depth that do not tell transients."""
_HIGHLIGHT = 0.6
"""Smoothed darkest channel from which a cell brighter than its render may be a highlight."""
_MANY, _SMALL = 0.25, 0.03
"""Share of the photos above which parts with a median below this share of a photo are no
transients: surfaces shine in most photos, each time elsewhere."""


class Residual(NamedTuple):
    """Difference of the render and a photo, in cells."""

    view: Frustum
    """The view at the size of the maps."""
    difference: np.ndarray
    """[h, w] float32, largest of the channels, smoothed; 0 where a mask hides the photo."""
    inverse_depth: np.ndarray
    """[h, w] float32, 1/training unit; 0 where the render is not opaque."""
    known: np.ndarray
    """[h, w] bool: cells that a mask of the capture does not hide."""
    highlight: np.ndarray
    """[h, w] bool: bright cells that are brighter than the render in all channels."""


def cells_of(width: int, height: int) -> tuple[int, int]:
    """Columns and rows of the maps of a photo."""
    scale = min(MOST_CELLS / max(width, height), 1.0)
    return max(round(width * scale), 1), max(round(height * scale), 1)


def residual_of(
    view: Frustum,
    render: np.ndarray,
    photo: np.ndarray,
    mask: np.ndarray | None,
    *,
    inverse_depth: np.ndarray,
    alpha: np.ndarray,
    threads: int = 0,
) -> Residual:
    """Compare a render with its photo.

    Args:
        view: The view.
        render: [H, W, 3] float32.
        photo: [H, W, 3] uint8.
        mask: [H, W] uint8, weight of each pixel, 255 = 1; None: 1 everywhere.
        inverse_depth: [H, W] float32, sum of weight / z.
        alpha: [H, W] float32.
        threads: 0: all cores.
    """
    width, height = cells_of(view.width, view.height)

    def smooth(picture: np.ndarray) -> np.ndarray:
        """[3, h, w]: reductions over short last axes are slow."""
        covariance = _SMOOTH**2, 0, _SMOOTH**2
        blurred = blur_image(torch.from_numpy(picture), covariance, threads=threads)
        return blurred.permute(2, 0, 1).contiguous().numpy()

    difference = render - photo * np.float32(1 / 255)
    np.nan_to_num(difference, copy=False, posinf=0, neginf=0)
    if mask is not None:
        difference *= (mask * np.float32(1 / 255))[..., None]
    channels = torch.from_numpy(difference).permute(2, 0, 1)
    cells = adaptive_avg_pool2d(channels, (height, width)).permute(1, 2, 0).numpy()
    difference = smooth(cells)
    bright = smooth(resize(photo, width, height) * np.float32(1 / 255)).min(axis=0) > _HIGHLIGHT
    # Depths of edges must not be averaged.
    rows, columns = (nearest_cells(a, b) for a, b in ((height, view.height), (width, view.width)))
    opacity = alpha[np.ix_(rows, columns)]
    depth = inverse_depth[np.ix_(rows, columns)] / np.maximum(opacity, 0.5)
    depth[opacity < 0.5] = 0
    known = np.ones((height, width), bool)
    if mask is not None:
        known = mask[np.ix_(rows, columns)] > 0
    K = scale_intrinsics(np.asarray(view.K), (view.width, view.height), (width, height))
    viewmat = np.asarray(view.viewmat, np.float64)
    return Residual(
        Frustum(viewmat, K, width, height, near=view.near),
        np.abs(difference).max(axis=0),
        np.nan_to_num(depth, posinf=0, neginf=0),
        known,
        bright & (difference < 0).all(axis=0),
    )


def find_transients(residuals: Mapping[int, Residual]) -> dict[int, np.ndarray]:
    """Find what single photos show.

    Args:
        residuals: By photo.

    Returns:
        [h, w] bool by photo, True: masked; without the photos that have none.
    """
    views = [one.view for one in residuals.values()]
    rotations = np.array([np.asarray(view.viewmat)[:3, :3] for view in views])
    moves = np.array([np.asarray(view.viewmat)[:3, 3] for view in views])
    places, looks = -np.einsum("vji,vj->vi", rotations, moves), rotations[:, 2]
    photos, found = list(residuals), {}
    differences = np.concatenate([one.difference[one.known] for one in residuals.values()])
    common = float(np.quantile(differences, _COMMON)) if len(differences) else 0.0
    limit = max(_DIFFERENT, _OFTEN * common)
    for k, (index, one) in enumerate(residuals.items()):
        cosines = (looks * looks[k]).sum(axis=1)
        far = np.sqrt(((places - places[k]) ** 2).sum(axis=1)) * (3 - 2 * cosines)
        far[(cosines < LARGEST_TURN) | (np.arange(len(far)) == k)] = np.inf
        order = np.lexsort((-cosines, far))  # at one place by direction
        near = [int(i) for i in order[:_NEAREST] if far[i] < np.inf]
        mask = _found(one, [residuals[photos[i]] for i in near], limit)
        if mask is not None:
            found[index] = mask
    shares = [mask.mean() for mask in found.values()]
    if len(found) > _MANY * len(photos) and np.median(shares) < _SMALL:
        return {}
    return found


def _found(one: Residual, others: Sequence[Residual], limit: float) -> np.ndarray | None:
    """Cells of a photo that only it shows, where differences exceed a limit; None: none."""
    cells = np.flatnonzero(one.difference > _LOWER * limit)
    if len(others) < _OTHERS or not len(cells):
        return None
    usual, count = _usual(one, others, cells)
    own, shape = one.difference.ravel()[cells], one.difference.shape
    seed, part = np.zeros(shape, bool), np.zeros(shape, bool)
    known = count >= _OTHERS
    part.ravel()[cells] = (own > _LOWER_TIMES * usual) & known
    seed.ravel()[cells] = (own > np.maximum(limit, _TIMES * usual)) & known
    seed &= part & ~one.highlight & ~_edges(one.inverse_depth)
    found = np.zeros(shape, bool)
    for connected in _parts(_connected(seed, part)):
        if connected.sum() >= _SMALLEST * connected.size:
            found |= connected
    for _ in range(_WIDER):
        found = _widened(found)
    found &= one.known
    return found if 0 < found.sum() <= _LARGEST * one.known.sum() else None


def _usual(
    one: Residual, others: Sequence[Residual], cells: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Median differences of the others at the surfaces of some cells, and the numbers of others
    that show them."""
    view, width = one.view, one.view.width
    inverse = one.inverse_depth.ravel()[cells].astype(np.float64)
    z = 1 / np.maximum(inverse, 1e-12)
    x, y = (cells % width + 0.5, cells // width + 0.5)
    K, viewmat = np.asarray(view.K), np.asarray(view.viewmat)
    rays = np.stack([(x - K[0, 2]) / K[0, 0] * z, (y - K[1, 2]) / K[1, 1] * z, z], axis=-1)
    world = np.einsum("ji,nj->ni", viewmat[:3, :3], rays - viewmat[:3, 3])
    values = np.full((len(others), len(cells)), np.nan)
    for row, other in zip(values, others, strict=True):
        K, viewmat = np.asarray(other.view.K), np.asarray(other.view.viewmat)
        x, y, z = np.einsum("ij,nj->in", viewmat[:3, :3], world) + viewmat[:3, 3:]
        ahead = (z > other.view.near) & (inverse > 0)
        z = np.where(ahead, z, 1.0)
        u, v = K[0, 0] * x / z + K[0, 2], K[1, 1] * y / z + K[1, 2]
        inside = ahead & (u >= 0) & (v >= 0) & (u < other.view.width) & (v < other.view.height)
        at = np.where(inside, v, 0).astype(int), np.where(inside, u, 0).astype(int)
        same = inside & (np.abs(z * other.inverse_depth[at] - 1) < _SAME_DEPTH)
        row[same] = other.difference[at][same]
    count = np.isfinite(values).sum(axis=0)
    ordered = np.sort(values, axis=0)  # NaN last
    middle = np.maximum(count - 1, 0)
    columns = np.arange(len(cells))
    usual = (ordered[middle // 2, columns] + ordered[(middle + 1) // 2, columns]) / 2
    return np.where(count > 0, usual, np.inf), count


def _edges(inverse_depth: np.ndarray) -> np.ndarray:
    """Cells near an edge of depth [h, w]: renders of outlines differ from a photo by themselves."""
    low, high = inverse_depth.copy(), inverse_depth.copy()
    for axis in (0, 1):
        for function, values in ((np.minimum, low), (np.maximum, high)):
            moved = values.swapaxes(0, axis)
            before = moved.copy()
            function(moved[1:], before[:-1], out=moved[1:])
            function(moved[:-1], before[1:], out=moved[:-1])
    edges = high > (1 + _SAME_DEPTH) * low
    for _ in range(_NEAR_EDGE):
        edges = _widened(edges)
    return edges


def _connected(seed: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Cells of `part` that are connected with a cell of `seed`."""
    found, count = seed, -1
    while count != (count := int(found.sum())):
        found = _widened(found) & part
    return found


def _widened(mask: np.ndarray) -> np.ndarray:
    """A mask [h, w] with the four neighbours of its cells."""
    out = mask.copy()
    out[1:] |= mask[:-1]
    out[:-1] |= mask[1:]
    out[:, 1:] |= mask[:, :-1]
    out[:, :-1] |= mask[:, 1:]
    return out


def _parts(mask: np.ndarray) -> Iterator[np.ndarray]:
    """Connected parts of a mask [h, w]."""
    left = mask.copy()
    while left.any():
        seed = np.zeros_like(mask)
        seed.ravel()[int(np.argmax(left))] = True
        one_part = _connected(seed, left)
        yield one_part
        left &= ~one_part


def nearest_cells(count: int, other: int) -> np.ndarray:
    """[count] int: indices of `other` cells at the centres of `count` others."""
    return (2 * np.arange(count) + 1) * other // (2 * count)
