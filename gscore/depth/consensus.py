"""Scale and offset of maps from each other: what one view's map says of another's surfaces.

Points of structure from motion often lie on the subject alone, so that a map's scale is known there
and guessed for the floor and the walls behind it. Where two views show the same floor, their maps
must place it alike: each view is fitted again to its points and to what the maps of the others,
placed by their own fits, say along its rays. A few rounds settle it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..scene import Cameras
from .align import LEAST_SHARE, align_robust
from .fit import Fit, judge
from .maps import sample
from .samples import Samples, grid_step

_MOST_VIEWS = 12
"""Other views that are asked: those that look most alike."""
_MOST_POINTS = 2000
"""Points of other views that are used, thinned at random."""
_DOUBT = 1.0
"""Expected relative error of a fit from which on its word is not taken."""
_MAP_ERROR = 0.2
"""Relative error that a map has at a pixel even where its fit is sure."""
ROUNDS = 3
"""Times that all views are fitted again; 0: to their points alone."""
_KEPT = 0.7
"""Share of the agreement with the view's own points that a new fit has to keep."""


def agreed(
    fits: Sequence[Fit | None], maps: Sequence[Samples | None], cameras: Cameras
) -> list[Fit | None]:
    """Fits that agree with the points of their views and with each other.

    Args:
        fits: Of each view by its points alone; accepted ones speak for their maps.
        maps: By view, affine in inverse depth; None: there is none.
        cameras: Of the views, at the size that the grids were thinned from.

    Returns:
        The fits. `points`, `inliers` and `error` still speak of the view's own points; a fit is
        only replaced by one that these do not contradict.
    """
    found = list(fits)
    for _ in range(ROUNDS):
        before = list(found)
        for index, fit in enumerate(before):
            mine = maps[index]
            if fit is not None and mine is not None and not mine.trouble:
                found[index] = _again(index, fit, mine, before, maps, cameras)
    return found


def _again(
    index: int,
    fit: Fit,
    mine: Samples,
    fits: Sequence[Fit | None],
    maps: Sequence[Samples | None],
    cameras: Cameras,
) -> Fit:
    """The fit of one view to its points and to the other maps; as it was if they do not help."""
    heard = [
        part
        for i in _alike(cameras, index, fits)
        if (other := fits[i]) is not None
        and (theirs := maps[i]) is not None
        and (part := _said(i, other, theirs, index, mine, cameras)) is not None
    ]
    if not heard:
        return fit
    values, inverse_depth, weights = (np.concatenate(parts) for parts in zip(*heard, strict=True))
    if len(values) > _MOST_POINTS:
        chosen = np.random.default_rng(index).choice(len(values), _MOST_POINTS, replace=False)
        values, inverse_depth, weights = values[chosen], inverse_depth[chosen], weights[chosen]
    own = np.isfinite(mine.values)
    share = mine.weights[own].sum() or 1.0
    candidate = align_robust(
        np.concatenate([mine.values[own], values]),
        np.concatenate([mine.inverse_depth[own], inverse_depth]),
        # The view's own points and all others count alike.
        np.concatenate([mine.weights[own] / share, weights / weights.sum()]),
    )
    if not candidate.accepted:
        return fit
    told = judge(
        candidate.scale,
        candidate.offset,
        mine.values[own],
        mine.inverse_depth[own],
        mine.weights[own],
    )
    if told.points and told.inliers < max(LEAST_SHARE, _KEPT * fit.inliers):
        return fit
    return replace(candidate, points=told.points, inliers=told.inliers, error=told.error)


def _said(
    i: int, fit: Fit, theirs: Samples, index: int, mine: Samples, cameras: Cameras
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """The map of view `index` where view `i` places surfaces: values, inverse depths, weights."""
    if not fit.accepted:
        return None
    inverse = fit.scale * theirs.grid + fit.offset
    doubt = fit.relative_error(theirs.grid)
    with np.errstate(invalid="ignore"):
        row, column = np.nonzero((inverse > 0) & (doubt < _DOUBT))
    if len(row) == 0:
        return None
    depth = 1 / inverse[row, column].astype(np.float64)
    step = grid_step(int(cameras.widths[i]))
    pixels = np.stack([column, row], 1) * step + step // 2 + 0.5
    rays = np.concatenate([pixels, np.ones((len(row), 1))], 1) @ np.linalg.inv(cameras.Ks[i]).T
    viewmat = cameras.viewmats[i]
    points = (rays * depth[:, None] - viewmat[:3, 3]) @ viewmat[:3, :3]
    viewmat = cameras.viewmats[index]
    local = points @ viewmat[:3, :3].T + viewmat[:3, 3]
    front = local[:, 2] > 0
    local, weight = local[front], 1 / (doubt[row, column][front] ** 2 + _MAP_ERROR**2)
    pixels = (local @ cameras.Ks[index].T)[:, :2] / local[:, 2:]
    size = (int(cameras.widths[index]), int(cameras.heights[index]))
    inside = ((pixels >= 0) & (pixels < size)).all(axis=1)
    step = grid_step(size[0])
    x, y = ((pixels[inside] - 0.5 - step // 2) / step).T
    values = sample(mine.grid, x, y)
    known = np.isfinite(values)
    if not known.any():
        return None
    return values[known], 1 / local[inside, 2][known], weight[inside][known].astype(np.float64)


def _alike(cameras: Cameras, index: int, fits: Sequence[Fit | None]) -> list[int]:
    """Other views with accepted fits, those with the nearest optical axes first."""
    axes = cameras.viewmats[:, 2, :3]
    others = [i for i, fit in enumerate(fits) if i != index and fit is not None and fit.accepted]
    return sorted(others, key=lambda i: -float(axes[i] @ axes[index]))[:_MOST_VIEWS]
