"""Coverage of held-out views by the training photos, and the worst view that they cover."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..raster.request import Frustum
from ..sampling import evenly_spaced
from .evaluate import Evaluation
from .photo_renders import PhotoRenders

COVERED = 0.9
"""Least share of a view that the training photos show for the view to test the training."""
_PHOTOS = 2
"""Photos that must show a place: a single one does not determine its depth."""
_CELLS = 32
"""Longer side of the held-out pictures, px: points of a photo leave no gaps in a picture from a
quarter of the distance."""
_MOST_PHOTOS = 256
"""Most training photos that are used, evenly spaced."""

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


def coverage(renders: PhotoRenders, photos: Any) -> dict[str, float]:
    """Share of each held-out view that at least two training photos show, by name.

    The render of each training photo is warped into the view by its depth; a part of the view is
    covered if points of two photos fall into it. The depth of the view itself is not used: where
    the model is wrong, such as behind a veil before the camera, the photos cover the view
    nevertheless.

    Args:
        renders: Renders of the training photos.
        photos: Dataset with `train`, `test`, `mask_mode` and `mask(i)`; masked pixels of held-out
            views do not count.

    Returns:
        Shares in [0, 1]; 1 for a view without pixels that count.
    """
    cameras, train = renders.cameras, list(photos.train)
    used = np.array(evenly_spaced(train, _MOST_PHOTOS))
    shares = {}
    for index in photos.test:
        view = renders.frustum(index, _CELLS)
        counted = _counted(photos, view, index).ravel()
        count = np.zeros(counted.shape, int)
        away = np.linalg.norm(cameras.centers[used] - cameras.centers[index], axis=1)
        for photo in used[np.argsort(away, kind="stable")]:  # the nearest show most of it
            if (count[counted] >= _PHOTOS).all():
                break
            shown = np.zeros(counted.shape, bool)
            shown[renders.warp(photo, view).pixels] = True
            count += shown
        share = (count[counted] >= _PHOTOS).mean() if counted.any() else 1.0
        shares[cameras.names[index]] = float(share)
    return shares


def _counted(photos: Any, view: Frustum, index: int) -> np.ndarray:
    """[H, W] bool: unmasked pixels of a view, by those of the mask at their centres."""
    shape = view.height, view.width
    mask = None if photos.mask_mode == "none" else photos.mask(index)
    if mask is None:
        return np.ones(shape, bool)
    rows, columns = (
        ((np.arange(n) + 0.5) * whole / n).astype(int)
        for n, whole in zip(shape, mask.shape, strict=True)
    )
    return mask[np.ix_(rows, columns)] >= 128
