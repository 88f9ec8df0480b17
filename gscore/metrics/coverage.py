"""Coverage of held-out views by the training photos, and the worst view that they cover."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from ..raster.api import Rendered, render_camera
from ..scene import Cameras
from ..splats import Splats
from .evaluate import Evaluation

COVERED = 0.9
"""Least share of a view that the training photos show for the view to test the training."""
_PHOTOS = 2
"""Photos that must show a place: a single one does not determine its depth."""
_SIDE, _CELLS = 128, 32
"""Longer sides of depth maps and of the held-out pictures, px: points of a photo leave no gaps in a
picture from a quarter of the distance."""
_MOST_PHOTOS = 256
"""Most training photos that are used, evenly spaced."""
_SOLID = 0.5
"""Least opacity of a pixel with a surface; the others are infinitely far."""
_FAR = 1e6
"""Their distance, in sizes of the capture."""
_LEAST_COSINE = 0.5
"""Cosine of the largest angle between the directions from which a photo and a view show a surface.
From the other side it would be another surface."""


WORST = ("psnr_cc", "ssim_cc")
"""Metrics of a worst view: structure and colours, without exposure."""


def state_coverage(evaluation: Evaluation, shares: Mapping[str, float]) -> None:
    """Add coverage to an evaluation of held-out views: `coverage` of each view; `worst_view`, the
    lowest value of the covered views with its view, by metric; `not_covered`, the other views.

    Args:
        evaluation: The metrics, changed in place.
        shares: Coverage of each view by name.
    """
    for view in evaluation.views:
        view["coverage"] = shares[view["name"]]
    covered = [view for view in evaluation.views if view["coverage"] >= COVERED]
    evaluation.mean["worst_view"] = {key: lowest_view(covered, key) for key in WORST}
    evaluation.mean["not_covered"] = [
        view["name"] for view in evaluation.views if view["coverage"] < COVERED
    ]


def lowest_view(views: Sequence[Mapping[str, Any]], key: str) -> dict[str, Any] | None:
    """Name and value of the view with the lowest value of a metric; None: none has it."""
    known = [view for view in views if view[key] is not None]
    worst = min(known, key=lambda view: view[key], default=None)
    return None if worst is None else {"view": worst["name"], "value": worst[key]}


def coverage(
    splats: Splats,
    cameras: Cameras,
    photos: Any,
    *,
    near: float = 0.01,
    antialias: bool = False,
    threads: int = 0,
) -> dict[str, float]:
    """Share of each held-out view that at least two training photos show, by name.

    The depth map of each training photo is warped into the view; a part of the view is covered if
    points of two photos fall into it that they see from within 60 degrees of its direction. The
    depth of the view itself is not used: where the model is wrong, such as behind a veil before
    the camera, the photos cover the view nevertheless.

    Args:
        splats: The model, world units.
        cameras: Cameras of the capture, same world.
        photos: Dataset with `train`, `test`, `mask_mode` and `mask(i)`; masked pixels of held-out
            views do not count.
        near: Near plane, world units.
        antialias: Whether opacities are compensated.
        threads: 0: all cores.

    Returns:
        Shares in [0, 1]; 1 for a view without pixels that count.
    """
    train = list(photos.train)
    places = np.linspace(0, len(train) - 1, min(len(train), _MOST_PHOTOS)).round().astype(int)
    used = np.array(train)[places]
    small, cells = _with_side(cameras, _SIDE), _with_side(cameras, _CELLS)
    far = _FAR * max(float(np.ptp(cameras.centers, axis=0).max()), near)

    @cache
    def points_of(photo: int) -> np.ndarray:
        drawn = render_camera(
            splats, small, photo, depths=True, near=near, antialias=antialias, threads=threads
        )
        return _points(small, photo, drawn, far)

    shares = {}
    for view in photos.test:
        counted = _counted(photos, cells, view)
        count = np.zeros(counted.shape, int)
        away = np.linalg.norm(cameras.centers[used] - cameras.centers[view], axis=1)
        for photo in used[np.argsort(away, kind="stable")]:  # the nearest show most of it
            if (count[counted] >= _PHOTOS).all():
                break
            count += _shown(cells, view, points_of(photo), cameras.centers[photo], near)
        share = (count[counted] >= _PHOTOS).mean() if counted.any() else 1.0
        shares[cameras.names[view]] = float(share)
    return shares


def _with_side(cameras: Cameras, longest: int) -> Cameras:
    """The cameras with pictures of at most `longest` pixels a side."""
    scale = np.minimum(longest / np.maximum(cameras.widths, cameras.heights), 1.0)
    widths, heights = (
        np.maximum(np.round(side * scale), 1).astype(side.dtype)
        for side in (cameras.widths, cameras.heights)
    )
    Ks = cameras.Ks.copy()
    Ks[:, 0] *= (widths / cameras.widths)[:, None]
    Ks[:, 1] *= (heights / cameras.heights)[:, None]
    return replace(cameras, widths=widths, heights=heights, Ks=Ks)


def _points(cameras: Cameras, view: int, drawn: Rendered, far: float) -> np.ndarray:
    """[H * W, 3] world points of the pixels; at depth `far` where there is no surface."""
    height, width = drawn.alpha.shape
    v, u = np.mgrid[:height, :width] + 0.5
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(cameras.Ks[view]).T
    z = np.where(drawn.alpha >= _SOLID, np.asarray(drawn.depth), far)[..., None]
    viewmat = cameras.viewmats[view]
    return ((rays * z).reshape(-1, 3) - viewmat[:3, 3]) @ viewmat[:3, :3]


def _shown(
    cameras: Cameras, view: int, points: np.ndarray, seen_from: np.ndarray, near: float
) -> np.ndarray:
    """[H, W] bool: pixels of a view into which points fall that `seen_from` sees from within 60
    degrees of the view's direction."""
    viewmat, K = cameras.viewmats[view], cameras.Ks[view]
    places = points @ viewmat[:3, :3].T + viewmat[:3, 3]
    z = places[:, 2]
    ahead = z > near
    u, v = (places @ K.T)[:, :2].T / np.where(ahead, z, 1.0)
    width, height = int(cameras.widths[view]), int(cameras.heights[view])
    inside = ahead & (u >= 0) & (u < width) & (v >= 0) & (v < height)
    ours, theirs = points - cameras.centers[view], points - seen_from
    lengths = np.linalg.norm(ours, axis=1) * np.linalg.norm(theirs, axis=1)
    inside &= np.einsum("pc,pc->p", ours, theirs) >= _LEAST_COSINE * lengths
    shown = np.zeros((height, width), bool)
    shown[v[inside].astype(int), u[inside].astype(int)] = True
    return shown


def _counted(photos: Any, cameras: Cameras, view: int) -> np.ndarray:
    """[H, W] bool: unmasked pixels of a view, by those of the mask at their centres."""
    shape = int(cameras.heights[view]), int(cameras.widths[view])
    mask = None if photos.mask_mode == "none" else photos.mask(view)
    if mask is None:
        return np.ones(shape, bool)
    rows, columns = (
        ((np.arange(n) + 0.5) * whole / n).astype(int)
        for n, whole in zip(shape, mask.shape, strict=True)
    )
    return mask[np.ix_(rows, columns)] >= 128
