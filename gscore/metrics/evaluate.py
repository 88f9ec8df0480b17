"""Evaluation of renders: every metric per view, means, and frames per second."""

import math
import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..errors import ShapeError
from ..events import MASKED_OF
from .image import EMPTY_MASK, colour_corrected, image_metrics
from .lpips import SHORTEST_SIDE, Lpips, LpipsNet
from .named import NAMED_METRICS

_AVERAGED = tuple(metric.key for metric in NAMED_METRICS if metric.averaged)
"""Keys of the metrics that have a mean, in the order of tables."""


@dataclass(frozen=True)
class Evaluation:
    """Metrics of the renders of some views."""

    mean: dict[str, Any]
    """Means by the keys of NAMED_METRICS and of the LPIPS network, `lpips_net`, and `fps`, 1 /
    median render time in seconds. A missing value is None, with its reason in `<key>_reason`."""
    views: list[dict[str, Any]] = field(default_factory=list)
    """The same for each view, with its `name`, `width`, `height` and `render_seconds`."""

    @classmethod
    def none(cls, reason: str) -> "Evaluation":
        """An evaluation without metrics, and its reason."""
        mean: dict[str, Any] = {}
        for key in ("psnr", "ssim", "lpips"):
            mean |= {key: None, f"{key}_reason": reason}
        return cls(mean)


ViewHook = Callable[[int, np.ndarray, np.ndarray, np.ndarray | None, dict[str, Any]], None]
"""Called with the position in `indices`, the target, the render ([H, W, 3] float), the [H, W] uint8
weights of its pixels or None, and the metrics."""


def target_picture(
    photo: np.ndarray,
    mask: np.ndarray | None,
    mask_mode: str,
    background: Sequence[float] = (0.0, 0.0, 0.0),
) -> tuple[np.ndarray, np.ndarray | None]:
    """Target of a render, and the weights of its pixels.

    Args:
        photo: [H, W, 3] uint8.
        mask: [H, W] uint8 or None.
        mask_mode: `composite`: the photo over `background`; `ignore`: the mask becomes weights;
            `none`: the photo unchanged.
        background: RGB in [0, 1].

    Returns:
        [H, W, 3] float64 target, [H, W] uint8 weights or None.
    """
    target = photo / 255.0
    if mask is None or mask_mode == "none":
        return target, None
    if mask_mode == "ignore":
        return target, mask
    alpha = mask[:, :, None] / 255.0
    return target * alpha + np.asarray(background, dtype=np.float64) * (1.0 - alpha), None


def masked_pair(
    picture: np.ndarray, target: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Both pictures with black pixels outside a mask, which makes them equal there.

    Args:
        picture: [H, W, 3] float, clipped to [0, 1] first.
        target: [H, W, 3] float in [0, 1].
        weights: [H, W] uint8, as returned by `target_picture`.
    """
    scale = weights[:, :, None] / 255.0
    return np.clip(picture, 0.0, 1.0) * scale, target * scale


def evaluate(
    render: Callable[[int], np.ndarray],
    dataset: Any,
    indices: Iterable[int],
    *,
    lpips: Lpips | LpipsNet | None = None,
    lpips_reason: str = "",
    background: Sequence[float] = (0.0, 0.0, 0.0),
    on_view: ViewHook | None = None,
) -> Evaluation:
    """Score a model on some views of a dataset.

    Args:
        render: Returns the picture of view i over `background`, [H, W, 3] float. This call is
            timed, so it should only render.
        dataset: The views; its scene.cameras.names, image(i), mask(i) and mask_mode are used.
        indices: Views to score.
        lpips: The perceptual metric, or None.
        lpips_reason: Why it is None, from `find_lpips`.
        background: RGB in [0, 1] under transparent photos (mask mode `composite`).
        on_view: Called after each view, to collect pictures or show progress.

    Returns:
        Means and views; `psnr_masked` only in mask mode `ignore`. Times exclude a warm-up render.

    Raises:
        ShapeError: A render has another size than its photo or is not finite.
    """
    views: list[dict[str, Any]] = []
    for place, index in enumerate(indices):
        if place == 0:
            render(index)  # warm up: the first call allocates and starts threads
        started = time.perf_counter()
        picture = render(index)
        seconds = time.perf_counter() - started
        name = dataset.scene.cameras.names[index]
        target, weights = target_picture(
            dataset.image(index), dataset.mask(index), dataset.mask_mode, background
        )
        if weights is None and dataset.mask_mode == "ignore":
            weights = np.full(target.shape[:2], 255, dtype=np.uint8)  # a view without a mask
        try:
            values = image_metrics(picture, target, mask=weights)
        except ShapeError as error:
            raise ShapeError(f"View {name} cannot be scored: {error}") from error
        _put_lpips(values, picture, target, weights, lpips, lpips_reason)
        height, width = target.shape[:2]
        view = {"name": name, "width": width, "height": height}
        view |= values | {"render_seconds": seconds}
        if "psnr_masked" in view and (of := getattr(dataset, "evaluated_part", "")):
            view[MASKED_OF] = of
        views.append(view)
        if on_view is not None:
            on_view(place, target, np.asarray(picture), weights, view)
    return Evaluation(_means(views, lpips), views)


def _put_lpips(
    values: dict[str, Any],
    picture: np.ndarray,
    target: np.ndarray,
    weights: np.ndarray | None,
    lpips: Lpips | LpipsNet | None,
    reason: str,
) -> None:
    values["lpips"] = values["lpips_cc"] = None
    if lpips is None:
        values["lpips_reason"] = values["lpips_cc_reason"] = reason or "not requested"
        return
    if min(target.shape[:2]) < SHORTEST_SIDE:
        small = f"needs {SHORTEST_SIDE} x {SHORTEST_SIDE} pixels"
        values["lpips_reason"] = values["lpips_cc_reason"] = small
    else:
        shown = {"lpips": picture, "lpips_cc": colour_corrected(picture, target, mask=weights)}
        for key, one in shown.items():
            pair = (one, target) if weights is None else masked_pair(one, target, weights)
            values[key] = lpips(*pair)
    values[lpips.key] = values["lpips"]


def _means(views: list[dict[str, Any]], lpips: Lpips | LpipsNet | None) -> dict[str, Any]:
    """Means over the views; None with the reason of the first view that lacks the value.

    A completely masked view is left out, because it would count as perfect.
    """
    counted = [view for view in views if view.get("psnr_masked_reason") != EMPTY_MASK]
    views = counted or views
    mean: dict[str, Any] = {"lpips_net": lpips.net if lpips else None}
    for key in _AVERAGED:
        if key == "psnr_masked":
            if not any(key in view for view in views):
                continue
            if MASKED_OF in views[0]:
                mean[MASKED_OF] = views[0][MASKED_OF]
        values = [view[key] for view in views if view.get(key) is not None]
        if values and len(values) == len(views):
            mean[key] = math.fsum(values) / len(values)
        else:
            lacking = next((view for view in views if view.get(key) is None), {})
            why = lacking.get(key + "_reason", "no mask")
            whole = key.startswith("lpips") or not lacking  # the reason is that of all views
            where = "" if whole else f" (view {lacking['name']})"
            mean[key] = None
            mean[key + "_reason"] = why + where if views else "no view to score"
    if lpips is not None:
        mean[lpips.key] = mean["lpips"]
    mean["fps"] = 1.0 / statistics.median(v["render_seconds"] for v in views) if views else None
    return mean
