"""Stereo depth maps of a capture's views: plane sweep, filter, consistency check; their cloud."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..datasets import Dataset
from ..datasets.dataset import map_threads
from ..datasets.resolution import divided_size, scale_intrinsics
from ..depth.observations import point_visibility
from ..io.images.read_image import resize
from ..raster.stereo_depth import Checked, StereoView, SweepResult, check, sweep
from ..scene import PointCloud
from ..text_format import count_text
from .plan import ViewPlan, plan_views, planes_of

_GREY = np.array([0.299, 0.587, 0.114], np.float32)
"""Luma of sRGB values (Rec. 601)."""
_HIDDEN = 128
"""Grey of masked pixels: no contrast, so they match nothing."""


@dataclass(frozen=True, kw_only=True)
class SmallPhoto:
    """Downscaled photo of one view."""

    index: int
    """Index in the dataset."""
    view: StereoView
    """Grey photo and camera."""
    rgb: np.ndarray
    """[H, W, 3] uint8."""
    counts: np.ndarray | None
    """[H, W] bool, unmasked pixels without the rim of the mask; None: all."""


def small_photo(dataset: Dataset, index: int, *, side: int, rim: int) -> SmallPhoto:
    """A view of the dataset, downscaled; decodes the photo if needed.

    Args:
        dataset: The capture.
        index: Index of the view.
        side: Maximum of the longer side, px.
        rim: Width of the excluded rim around masked pixels, px, because windows reach over it.
    """
    image, mask = dataset.image(index), dataset.mask(index)
    if dataset.mask_mode == "none":
        mask = None
    cameras = dataset.scene.cameras
    old = int(cameras.widths[index]), int(cameras.heights[index])
    new = divided_size(*old, max(1.0, max(old) / side))
    image = resize(image, *new)
    grey = (image.astype(np.float32) @ _GREY + np.float32(0.5)).astype(np.uint8)
    counts = None
    if mask is not None and mask.min() < 255:
        shown = resize(mask, *new) >= 128
        grey[~shown] = _HIDDEN
        counts = _shrunk(shown, rim)
    K = scale_intrinsics(cameras.Ks[index], old, new)
    return SmallPhoto(
        index=index,
        view=StereoView(grey, K, cameras.viewmats[index]),
        rgb=image,
        counts=counts,
    )


def _shrunk(shown: np.ndarray, rim: int) -> np.ndarray:
    """Erosion [H, W] bool by a square of radius `rim`."""
    hidden = np.pad(~shown, rim)
    for axis in (0, 1):
        size = shown.shape[axis]
        parts: Sequence[np.ndarray] = [
            np.take(hidden, range(k, k + size), axis=axis) for k in range(2 * rim + 1)
        ]
        hidden = np.logical_or.reduce(parts)
    return ~hidden


MAP_SIDE = 400
"""Default longer side of the compared photos, px."""
RADIUS = 3
"""Radius of the windows, which are 7 x 7 px."""
_SURE, _SCORE = 0.9, 0.6
"""Score of full confidence, and minimum score."""
_CONTRAST = 3.0
"""Minimum standard deviation of grey values in a window: sky and walls match at any depth."""
_CLEAR = 0.85
"""Maximum score of the second best depth, relative to the best."""
AGREE = 2
"""Minimum number of other views with the same surface."""
FEWEST_VIEWS = 3
"""Minimum number of views, so that each has two neighbours."""


@dataclass(frozen=True, kw_only=True)
class StereoMap:
    """Depth map of one view, confirmed by others."""

    photo: SmallPhoto
    inverse_depth: np.ndarray
    """[H, W] float32, 1/world unit; 0: unknown."""
    confidence: np.ndarray
    """[H, W] float32 in [0, 1]; 0: unknown."""
    agree: np.ndarray
    """[H, W] uint8, number of other views with the same surface."""


@dataclass(frozen=True, kw_only=True)
class StereoMaps:
    """Depth maps of a capture."""

    maps: dict[int, StereoMap]
    """Maps by index of the view; views without any depth are missing."""
    known: float = 0.0
    """Share of pixels with a depth among the unmasked ones of the requested views."""
    reason: str = ""
    """Why there are no maps, a clause without a full stop; empty if there are some."""


def stereo_maps(
    dataset: Dataset,
    used: Sequence[int],
    *,
    side: int = MAP_SIDE,
    threads: int = 0,
    on_view: Callable[[int, int], None] | None = None,
) -> StereoMaps:
    """Compute the depth maps of views from each other.

    Args:
        dataset: The capture.
        used: Indices of the participating views; no other photo is read.
        side: Longer side of the compared photos, px; the time grows with its cube.
        threads: 0: all cores.
        on_view: Called with (done, total) after each view; may raise to stop.

    Returns:
        Maps of the views with any depth; bit for bit equal for any number of threads.
    """
    if len(used) < FEWEST_VIEWS:
        few = f"it needs at least {count_text(FEWEST_VIEWS, 'photo')}"
        return StereoMaps(maps={}, reason=few)
    subject = dataset.mask_mode == "composite"
    tracks = point_visibility(dataset)
    plans = plan_views(dataset.scene.cameras, tracks, used, subject=subject)
    if not any(plans):
        why = "no two photos show the same surface from different places"
        if len(tracks.points) == 0:
            why += ", or their axes do not meet, which without SfM points is needed for a range"
        return StereoMaps(maps={}, reason=why)
    photos = list(
        map_threads(
            lambda i: small_photo(dataset, i, side=side, rim=RADIUS), list(used), threads=threads
        )
    )
    first: list[np.ndarray] = []
    scores: list[np.ndarray] = []
    for place, (photo, plan) in enumerate(zip(photos, plans, strict=True)):
        inverse_depth, score = _swept(photo, plan, photos, threads)
        first.append(inverse_depth)
        scores.append(score)
        if on_view is not None:
            on_view(place + 1, len(photos))
    found = {}
    for place, (photo, plan) in enumerate(zip(photos, plans, strict=True)):
        if plan is None:
            continue
        neighbours = [(photos[i].view, first[i]) for i in plan.neighbours]
        checked = check(photo.view, first[place], neighbours, threads=threads)
        one = _filtered(photo, scores[place], checked)
        if (one.inverse_depth > 0).any():
            found[photo.index] = one
    if not found:
        return StereoMaps(maps={}, reason="no depth of a photo is confirmed by two others")
    known = sum(int((one.inverse_depth > 0).sum()) for one in found.values())
    unmasked = sum(
        photo.view.grey.size if photo.counts is None else int(photo.counts.sum())
        for photo in photos
    )
    return StereoMaps(maps=found, known=known / unmasked)


def _swept(
    photo: SmallPhoto, plan: ViewPlan | None, photos: Sequence[SmallPhoto], threads: int
) -> tuple[np.ndarray, np.ndarray]:
    """Inverse depth of a view, 0 where it is ambiguous, and its score."""
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


def _clear(photo: SmallPhoto, swept: SweepResult) -> np.ndarray:
    """[H, W] bool: the best depth is unambiguous."""
    clear = (swept.score >= _SCORE) & (swept.contrast >= _CONTRAST)
    clear &= swept.second_best <= _CLEAR * swept.score
    return clear if photo.counts is None else clear & photo.counts


def _filtered(photo: SmallPhoto, score: np.ndarray, checked: Checked) -> StereoMap:
    """The map after the consistency check, with its confidence."""
    good = (checked.agree >= AGREE) & (checked.contradict < checked.agree)
    share = np.clip((score - _SCORE) / (_SURE - _SCORE), 0, 1)
    support = np.minimum(checked.agree, 4) / np.float32(4)
    confidence = np.where(good, (0.5 + 0.5 * share) * support, 0).astype(np.float32)
    return StereoMap(
        photo=photo,
        inverse_depth=np.where(good, checked.inverse_depth, np.float32(0)),
        confidence=confidence,
        agree=np.where(good, checked.agree, np.uint8(0)),
    )


_ROUNDS = 24
"""Bisection steps for the cell size."""
_A_POINT = 12
"""Number of pixels read per point; rows and columns are skipped if there are more."""
_LARGEST = 64.0
"""Largest cell, px."""


def dense_points(maps: StereoMaps, *, most: int) -> PointCloud:
    """At most `most` points, one per cell of space; the cell size in photo pixels is uniform.

    A point is the mean position and colour of all map pixels in its cell, so views that agree share
    a point. Cell sizes grow with the distance to the photo in powers of two.
    """
    if not maps.maps or most <= 0:
        return PointCloud.none()
    known = sum(int((found.inverse_depth > 0).sum()) for found in maps.maps.values())
    step = max(1, int((known / (_A_POINT * most)) ** 0.5))
    parts = [_of_map(found, step) for found in maps.maps.values()]
    points, colors, footprints = (np.concatenate(column) for column in zip(*parts, strict=True))
    if len(points) == 0:
        return PointCloud.none()
    low, high = 0.0, np.log2(_LARGEST)
    cells = _cells(points, footprints, 2.0**high)
    for _ in range(_ROUNDS):
        middle = 0.5 * (low + high)
        tried = _cells(points, footprints, 2.0**middle)
        if tried.max() < most:
            high, cells = middle, tried
        else:
            low = middle
        if 0.97 * most < cells.max() + 1 <= most:
            break
    if cells.max() >= most:
        keep = cells < most
        points, colors, cells = points[keep], colors[keep], cells[keep]
    count = np.bincount(cells)
    places = np.stack([np.bincount(cells, points[:, k]) / count for k in range(3)], axis=1)
    tones = np.stack([np.bincount(cells, colors[:, k]) / count for k in range(3)], axis=1)
    return PointCloud(points=places, colors=np.rint(tones).astype(np.uint8))


def _of_map(found: StereoMap, step: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points [P, 3] in the world, colours [P, 3] and pixel sizes [P], world units, from every
    `step`-th row and column."""
    view = found.photo.view
    v, u = (step * a for a in np.nonzero(found.inverse_depth[::step, ::step] > 0))
    depth = 1 / found.inverse_depth[v, u].astype(np.float64)
    pixels = np.stack([u + 0.5, v + 0.5, np.ones(len(u))], axis=1)
    rays = pixels @ np.linalg.inv(view.K).T
    points = (rays * depth[:, None] - view.viewmat[:3, 3]) @ view.viewmat[:3, :3]
    return points, found.photo.rgb[v, u], depth / view.K[0, 0]


def _cells(points: np.ndarray, footprints: np.ndarray, size: float) -> np.ndarray:
    """Cell index [P] of each point, from 0; cells are `size` to 2 * `size` pixels large."""
    level = np.ceil(np.log2(footprints * size))
    places = np.floor(points / np.exp2(level)[:, None]).astype(np.int64)
    keys = np.column_stack([level.astype(np.int64), places])
    packed = np.zeros(len(keys), np.uint64)
    with np.errstate(over="ignore"):
        for column in keys.T:  # a hash: rare collisions only merge two cells
            packed = (packed ^ column.astype(np.uint64)) * np.uint64(0x9E3779B97F4A7C15)
            packed ^= packed >> np.uint64(29)
    return np.unique(packed, return_inverse=True)[1]
