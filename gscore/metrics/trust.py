"""Trust in views between training photos: the share of them that photos nearby confirm."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from statistics import median
from typing import Any

import numpy as np

from ..camera_neighbours import LARGEST_TURN, pairs_with_views_between
from ..raster.request import Frustum
from ..sampling import evenly_spaced
from ..scene import Cameras, camera_centers
from .coverage import coverage, state_coverage
from .evaluate import Evaluation
from .photo_renders import PhotoRenders, Warped

_SIDE = 64
"""Longer side of a view, px."""
_MOST_VIEWS = 96
_PHOTOS = 8
"""Photos that are compared with a view: the nearest."""
_COLOUR = 0.05
"""Largest difference of colours that confirms a place: mean of the channels and photos."""
_BEHIND = 1.05
"""Points of a photo are hidden in a pixel if they are this many times as far as its nearest one."""


def trust_between(renders: PhotoRenders, train: Sequence[int]) -> list[dict[str, Any]]:
    """Trust in the views halfway between neighbouring training photos.

    At most 96 of them, evenly chosen; none between photos turned by more than 60 degrees, and none
    of a single photo.

    Args:
        renders: Renders of the training photos.
        train: Indices of the training photos.

    Returns:
        `between`, the names of both photos, and `trust`, as by `trust`, of each view.
    """
    cameras, train = renders.cameras, list(train)
    if len(train) < 2:
        return []
    pairs = list(pairs_with_views_between(cameras, train))
    return [
        {
            "between": [cameras.names[a], cameras.names[b]],
            "trust": trust(renders, train, _halfway(renders, a, b)),
        }
        for a, b in evenly_spaced(pairs, _MOST_VIEWS)
    ]


def trust(renders: PhotoRenders, train: Sequence[int], view: Frustum) -> float:
    """Share of a view that the eight nearest training photos confirm.

    The render of each photo is warped into the view by its depth. A pixel is confirmed if the
    colours that they show there differ from that of the view by less than 0.05 on average, over the
    channels and over those photos that show the place; a place that none shows is not. So veils,
    floaters, changing colours and unseen places lower the trust, and wrong depths where they are
    visible.

    Args:
        renders: Renders of the training photos.
        train: Indices of the training photos; those that look in another direction are not used.
        view: The view, in the world of the renders.

    Returns:
        The share, in [0, 1].
    """
    own = renders.colours(view)
    differences, photos = np.zeros(len(own)), np.zeros(len(own), int)
    for photo in _nearest(renders.cameras, train, view):
        colours, shown = _shown(renders.warp(photo, view), len(own))
        differences += np.where(shown, abs(colours - own).mean(axis=1), 0.0)
        photos += shown
    return float((differences < _COLOUR * photos).mean())


def trust_figures(found: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Entries of metrics.json: `trust`, `trust_median`, and `trust_lowest`, the view of the lowest
    trust; none without views.

    Args:
        found: Result of `trust_between`.
    """
    if not found:
        return {}
    return {
        "trust": list(found),
        "trust_median": median(each["trust"] for each in found),
        "trust_lowest": dict(min(found, key=lambda each: each["trust"])),
    }


def state_reach(
    evaluation: Evaluation,
    renders: PhotoRenders,
    photos: Any,
    *,
    split: str,
    foreign: bool = False,
) -> None:
    """Add to an evaluation what holds for other views than the measured ones: which test views the
    training photos cover, and the trust in the views between these.

    Args:
        evaluation: The metrics, changed in place.
        renders: Renders of the training photos.
        photos: Dataset with `train`, `test`, `mask_mode` and `mask(i)`.
        split: The measured views: test, train or all.
        foreign: Whether the photos are not those of the training.
    """
    if split == "test":
        state_coverage(evaluation, coverage(renders, photos))
    # Backgrounds alike in all views, of masks or of another scene, confirm any model.
    if photos.mask_mode != "composite" and not foreign:
        evaluation.mean.update(trust_figures(trust_between(renders, photos.train)))


def _shown(warped: Warped, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean colour of a photo's visible points in each of `count` pixels, [count, 3], and whether
    there are any, [count] bool."""
    nearest = np.full(count, np.inf)
    np.minimum.at(nearest, warped.pixels, warped.z)
    visible = warped.z <= _BEHIND * nearest[warped.pixels]
    pixels, rgb = warped.pixels[visible], warped.rgb[visible]
    points = np.bincount(pixels, minlength=count)
    sums = np.stack([np.bincount(pixels, channel, minlength=count) for channel in rgb.T], axis=1)
    return sums / np.maximum(points, 1)[:, None], points > 0


def _nearest(cameras: Cameras, train: Sequence[int], view: Frustum) -> np.ndarray:
    """Indices of the nearest training photos that look in a similar direction."""
    alike = cameras.viewmats[train][:, 2, :3] @ view.viewmat[2, :3] >= LARGEST_TURN
    photos = np.asarray(train)[alike]
    away = np.linalg.norm(cameras.centers[photos] - camera_centers(view.viewmat[None]), axis=1)
    return photos[np.argsort(away, kind="stable")[:_PHOTOS]]


def _halfway(renders: PhotoRenders, a: int, b: int) -> Frustum:
    """The view from the middle between two photos in their mean direction, with the intrinsics and
    the roll of the first."""
    first, viewmats = renders.frustum(a, _SIDE), renders.cameras.viewmats[[a, b]]
    z = viewmats[:, 2, :3].sum(axis=0)
    z /= np.linalg.norm(z)
    x = np.cross(viewmats[0, 1, :3], z)
    x /= np.linalg.norm(x)
    viewmat = np.eye(4)
    viewmat[:3, :3] = x, np.cross(z, x), z
    viewmat[:3, 3] = -viewmat[:3, :3] @ camera_centers(viewmats).mean(axis=0)
    return replace(first, viewmat=viewmat)
