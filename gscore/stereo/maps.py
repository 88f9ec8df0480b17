"""Stereo depth maps of a capture's views: plane sweep, filter, consistency check."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..datasets import Dataset
from ..datasets.dataset import map_threads
from ..depth.observations import seen_points
from ..raster.stereo import Checked, Swept, check, sweep
from ..text_format import count_words
from .photos import SmallPhoto, small_photo
from .plan import ViewPlan, plan_views, planes_of

MAP_SIDE = 400
"""Longer side of the photos that are compared, pixels, where nothing else is asked for."""
RADIUS = 3
"""Windows are 7 x 7 pixels."""
_SURE, _SCORE = 0.9, 0.6
"""Score that is as good as any, and least one."""
_CONTRAST = 3.0
"""Least standard deviation of grey values in a window: sky and walls agree at any depth."""
_CLEAR = 0.85
"""The second best depth scores at most this share of the best."""
AGREE = 2
"""Other views that must have the same surface."""
FEWEST_VIEWS = 3
"""Views of which each can be judged by two others."""


@dataclass(frozen=True, kw_only=True)
class StereoMap:
    """The depth of one view that others confirm."""

    photo: SmallPhoto
    inverse_depth: np.ndarray
    """[H, W] float32, 1/world unit; 0: unknown."""
    confidence: np.ndarray
    """[H, W] float32 in [0, 1]; 0: unknown."""
    agree: np.ndarray
    """[H, W] uint8, other views that have the same surface there."""


@dataclass(frozen=True, kw_only=True)
class StereoMaps:
    """The depth of a capture."""

    maps: dict[int, StereoMap]
    """By index of the view; views of which nothing is known are missing."""
    known: float = 0.0
    """Share of the pixels whose depth is known, of those that count in the views asked for."""
    reason: str = ""
    """Why there are none, a clause without a full stop; empty if there are some."""


def stereo_maps(
    dataset: Dataset,
    used: Sequence[int],
    *,
    side: int = MAP_SIDE,
    threads: int = 0,
    on_view: Callable[[int, int], None] | None = None,
) -> StereoMaps:
    """Find the depth of views from each other.

    Args:
        dataset: The capture.
        used: Indices of the views that take part; no other photo is looked at.
        side: Pixels of the longer side of the photos that are compared; the time grows with its
            cube.
        threads: 0: all cores.
        on_view: Called with (done, total) after each view; may raise to stop.

    Returns:
        The maps of those of `used` in which anything is known. The same bits for any number of
        threads.
    """
    if len(used) < FEWEST_VIEWS:
        return StereoMaps(maps={}, reason=f"it takes at least {count_words(FEWEST_VIEWS, 'photo')}")
    subject = dataset.mask_mode == "composite"
    tracks = seen_points(dataset)
    plans = plan_views(dataset.scene.cameras, tracks, used, subject=subject)
    if not any(plans):
        why = "no two photos show the same from different places"
        if len(tracks.points) == 0:
            why += ", or they look at no common place, which without points must tell how far"
        return StereoMaps(maps={}, reason=why)
    photos = list(
        map_threads(
            lambda i: small_photo(dataset, i, side=side, rim=RADIUS), list(used), threads=threads
        )
    )
    first: list[np.ndarray] = []
    trust: list[np.ndarray] = []
    for place, (photo, plan) in enumerate(zip(photos, plans, strict=True)):
        inverse_depth, score = _swept(photo, plan, photos, threads)
        first.append(inverse_depth)
        trust.append(score)
        if on_view is not None:
            on_view(place + 1, len(photos))
    found = {}
    for place, (photo, plan) in enumerate(zip(photos, plans, strict=True)):
        if plan is None:
            continue
        witnesses = [(photos[i].view, first[i]) for i in plan.witnesses]
        checked = check(photo.view, first[place], witnesses, threads=threads)
        one = _judged(photo, trust[place], checked)
        if (one.inverse_depth > 0).any():
            found[photo.index] = one
    if not found:
        return StereoMaps(
            maps={}, reason="no depth that one photo shows is confirmed by two others"
        )
    known = sum(int((one.inverse_depth > 0).sum()) for one in found.values())
    return StereoMaps(maps=found, known=known / sum(map(_counting, photos)))


def _counting(photo: SmallPhoto) -> int:
    """Pixels of a photo that masks do not hide."""
    return photo.view.grey.size if photo.counts is None else int(photo.counts.sum())


def _swept(
    photo: SmallPhoto, plan: ViewPlan | None, photos: Sequence[SmallPhoto], threads: int
) -> tuple[np.ndarray, np.ndarray]:
    """Inverse depth of a view, 0 where it is not clear, and its score."""
    if plan is None:
        return np.zeros(photo.view.grey.shape, np.float32), np.zeros(
            photo.view.grey.shape, np.float32
        )
    views = [photo.view, *(photos[i].view for i in plan.sources)]
    swept = sweep(
        views[0],
        views[1:],
        farthest=plan.farthest,
        nearest=plan.nearest,
        planes=planes_of(plan, views),
        radius=RADIUS,
        threads=threads,
    )
    return np.where(_clear(photo, swept), swept.inverse_depth, np.float32(0)), swept.score


def _clear(photo: SmallPhoto, swept: Swept) -> np.ndarray:
    """[H, W] bool: one depth stands out there."""
    clear = (swept.score >= _SCORE) & (swept.contrast >= _CONTRAST)
    clear &= swept.rival <= _CLEAR * swept.score
    return clear if photo.counts is None else clear & photo.counts


def _judged(photo: SmallPhoto, score: np.ndarray, checked: Checked) -> StereoMap:
    """What is left of a map after others were asked."""
    good = (checked.agree >= AGREE) & (checked.contradict < checked.agree)
    share = np.clip((score - _SCORE) / (_SURE - _SCORE), 0, 1)
    witnesses = np.minimum(checked.agree, 4) / np.float32(4)
    confidence = np.where(good, (0.5 + 0.5 * share) * witnesses, 0).astype(np.float32)
    return StereoMap(
        photo=photo,
        inverse_depth=np.where(good, checked.inverse_depth, np.float32(0)),
        confidence=confidence,
        agree=np.where(good, checked.agree, np.uint8(0)),
    )
