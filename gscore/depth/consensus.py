"""Depth consensus: scale and offset of depth maps from the maps of other views.

SfM points are often on the subject only, so a map's scale is known there and extrapolated to the
floor and walls behind it. Where two views show the same floor, their maps must agree. So all maps
are aligned jointly, to their points and to each other (`joint`).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..scene import Cameras
from .align import LEAST_SHARE, REVERSED, is_significant
from .fit import Fit, fit_of
from .joint import Web, covariances, place
from .posed_depth_map import PosedDepthMap, inverse_depth, prepare_depth_map
from .samples import Samples

_MOST_VIEWS = 12
"""Number of other views that a map is compared with: those with the most similar directions."""
_PIXELS = 400
"""Maximum number of sampled pixels per map."""
_MOST_PIXELS = 5000
"""Maximum number over all maps, but at least _LEAST_PIXELS each."""
_LEAST_PIXELS = 100
_RATIOS = (2.0, 3.5, 7.0)
"""Initial ratios between the inverse depths of the ends of all maps."""
_ROUGH_PIXELS = 5000
"""Approximate number of sampled pixels of all maps in the search for the best start."""
_FACTORS = (4.0, 2.0, 1.0)
"""Widths of the penalties of successive minimisations, see `place`."""
_DETERMINED = 0.03
"""Maximum expected relative error at both ends of a map that needs no others."""
_NEAR = 0.15
"""Maximum log ratio of inverse depths of a map and an agreeing point or map."""
_OVERLAP = 0.05
"""Minimum number of pixels of other maps in a map's frame, as a share of its own."""


def agreed(
    fits: Sequence[Fit | None], maps: Sequence[Samples | None], cameras: Cameras
) -> list[Fit | None]:
    """Fits that agree with the points of all views and with each other.

    Args:
        fits: Fit of each view to its own points.
        maps: Samples by view, affine in inverse depth; None: there is no map.
        cameras: Cameras at the size of the grids' source.

    Returns:
        The fits, with their expected errors. `points`, `inliers` and `error` refer to the view's
        own points. A map that contradicts points and other maps is refused, and does not count for
        the others; one that overlaps no other, or is well known from its points, keeps its fit.
    """
    usable = [
        part if fit is not None and fit.reason != REVERSED else None
        for part, fit in zip(maps, fits, strict=True)
    ]
    found, (views, web) = list(fits), _web(usable, cameras)
    determined = {i for k, i in enumerate(views) if _determined(web.depth_maps[k], fits[i])}
    if len(views) < 2 or len(determined) == len(views):
        return found
    logs = _placed(web, [fits[i] for i in views])
    reasons = [_refusal(web, k, logs) for k in range(len(views))]
    good = [k for k, reason in enumerate(reasons) if reason == ""]
    if 2 <= len(good) < len(views):
        logs[good] = place(web.only(good), logs[good])[1]
    for k, i in enumerate(views):
        reason = reasons[k]
        if reason is not None and i not in determined:
            fit = fit_of(*web.depth_maps[k].line(np.exp(logs[k])), *_own_points(maps[i]))
            found[i] = fit.refused(reason) if reason else fit
    return with_errors(found, maps, cameras)


def with_errors(
    fits: Sequence[Fit | None], maps: Sequence[Samples | None], cameras: Cameras
) -> list[Fit | None]:
    """The same fits with their expected errors, from points and other maps."""
    found, (views, web) = list(fits), _web(maps, cameras)
    known = {
        k: (fit, ends)
        for k, i in enumerate(views)
        if (fit := fits[i]) is not None
        and fit.accepted
        and (ends := web.depth_maps[k].ends(fit)) is not None
    }
    if len(known) < 2 or all(_determined(web.depth_maps[k], fit) for k, (fit, _) in known.items()):
        return found
    errors = covariances(web.only(list(known)), np.log([ends for _, ends in known.values()]))
    for (k, (fit, ends)), covariance in zip(known.items(), errors, strict=True):
        if not _determined(web.depth_maps[k], fit):
            found[views[k]] = replace(fit, **web.depth_maps[k].uncertainty(ends, covariance))
    return found


def _web(maps: Sequence[Samples | None], cameras: Cameras) -> tuple[list[int], Web]:
    """Indices of the views whose maps can be compared, and these maps."""
    there = sum(samples is not None for samples in maps)
    count = min(_PIXELS, max(_LEAST_PIXELS, _MOST_PIXELS // max(there, 1)))
    depth_maps = {
        i: found
        for i, samples in enumerate(maps)
        if samples is not None
        and (found := prepare_depth_map(samples, cameras, i, count=count)) is not None
    }
    axes = cameras.viewmats[list(depth_maps), 2, :3]
    similarity = axes @ axes.T - 3 * np.eye(len(axes))  # itself comes last
    order = np.argsort(-similarity, axis=1, kind="stable")[:, : min(_MOST_VIEWS, len(axes) - 1)]
    return list(depth_maps), Web(depth_maps=list(depth_maps.values()), neighbours=order.tolist())


def _placed(web: Web, fits: Sequence[Fit | None]) -> np.ndarray:
    """[V, 2] logs of the ends with the least contradiction, from several starts: the fits to points
    only, and ends of one ratio for all maps."""
    every = [
        depth_map.point_inverse for depth_map in web.depth_maps if len(depth_map.point_inverse)
    ]
    middle = float(np.median(np.concatenate(every))) if every else 1.0
    starts = [
        np.stack([_through_points(c, middle, ratio) for c in web.depth_maps]) for ratio in _RATIOS
    ]
    stated = [
        other if fit is None or not fit.accepted or (ends := depth_map.ends(fit)) is None else ends
        for depth_map, fit, other in zip(web.depth_maps, fits, starts[0], strict=True)
    ]
    pixels = sum(len(depth_map.tones) for depth_map in web.depth_maps)
    rough = web.thinned(max(1, pixels // _ROUGH_PIXELS))
    tried = [place(rough, np.log(ends), factors=_FACTORS) for ends in [np.stack(stated), *starts]]
    return place(web, min(tried, key=lambda found: found[0])[1])[1]


def _determined(depth_map: PosedDepthMap, fit: Fit | None) -> bool:
    """Whether the points alone determine the map better than other maps would."""
    if fit is None or not fit.accepted:
        return False
    return bool((fit.relative_error(np.array([depth_map.low, depth_map.high])) < _DETERMINED).all())


def _through_points(depth_map: PosedDepthMap, middle: float, ratio: float) -> np.ndarray:
    """[2] ends of this ratio with the median point between them, or `middle` without points."""
    tone, level = 0.5, middle
    if len(depth_map.point_inverse):
        tone = float(np.clip(np.median(depth_map.point_tones), 0, 1))
        level = float(np.median(depth_map.point_inverse))
    far = level / (1 - tone + ratio * tone)
    return np.array([far, far * ratio])


def _own_points(samples: Samples | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    assert samples is not None
    use = np.isfinite(samples.values)
    return samples.values[use], samples.inverse_depth[use], samples.weights[use]


def _refusal(web: Web, index: int, logs: np.ndarray) -> str | None:
    """Why points and other maps refuse a map; empty if they do not, None if no other map overlaps.

    The points have the same total weight as all maps.
    """
    depth_map = web.depth_maps[index]
    tones, stated = [], []
    for i in web.projected_onto(index):
        other = web.depth_maps[i]
        seen, inverse = depth_map.look_up(other.points(inverse_depth(np.exp(logs[i]), other.tones)))
        tones.append(seen[np.isfinite(seen)])
        stated.append(inverse[np.isfinite(seen)])
    count = sum(len(part) for part in tones)
    if count < _OVERLAP * len(depth_map.tones):
        return None
    weights = np.concatenate([depth_map.point_weights, np.full(count, 1 / count)])
    own = np.log(
        inverse_depth(np.exp(logs[index]), np.concatenate([depth_map.point_tones, *tones]))
    )
    expected = np.log(np.concatenate([depth_map.point_inverse, *stated]))
    low, high = np.quantile(expected, (0.05, 0.95))
    near = min(_NEAR, 0.3 * float(high - low))
    share = float(weights[np.abs(own - expected) <= near].sum() / weights.sum())
    if share < LEAST_SHARE:
        return (
            f"only {share:.0%} of points and other maps, by weight, agree with one scale and offset"
        )
    if not is_significant(own, expected, weights, near):
        return "the map does not follow the depth of points and other maps"
    return ""
