"""Time of pictures and gradients on a device, kernel by kernel."""

from functools import partial
from typing import Any

import numpy as np

from ...splats import PARAMETERS
from ..request import Frustum, Settings
from .gpu_raster import GpuRaster
from .header import GRADIENTS

WARM, TIMED = 3, 20
"""Pictures that are not counted, and those that are."""


def timing_splats(count: int) -> list[np.ndarray]:
    """Random splats of SH degree 3, in the order of `PARAMETERS`: half a pixel to ten in size at
    full HD, in front of a camera at the origin."""
    random = np.random.default_rng(1)
    means = random.uniform(-1, 1, (count, 3)).astype(np.float32) * (1.6, 0.9, 1) + (0, 0, 3)
    scales = np.log(random.uniform(0.1, 1, (count, 3)) * 0.02 * (3e5 / count) ** (1 / 3))
    return [
        means.astype(np.float32),
        random.normal(size=(count, 4)).astype(np.float32),
        scales.astype(np.float32),
        random.normal(size=count).astype(np.float32) * 2,
        random.normal(size=(count, 1, 3)).astype(np.float32),
        random.normal(size=(count, 15, 3)).astype(np.float32) * np.float32(0.2),
    ]


def timing_view(width: int) -> Frustum:
    """A camera at the origin with pictures of 16 : 9."""
    height = round(width * 9 / 16)
    focal = 0.9 * width
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    return Frustum(np.eye(4), K, width, height)


def picture_of(
    raster: Any, arrays: list[np.ndarray], view: Frustum, settings: Settings | None = None
) -> np.ndarray:
    """The picture of a workspace, [H, W, 3]."""
    size = (view.height, view.width)
    pictures = {"rgb": np.empty((*size, 3), np.float32), "alpha": np.empty(size, np.float32)}
    raster.forward(arrays, view, settings or Settings(), pictures)
    return pictures["rgb"]


def timed_pictures(
    raster: GpuRaster, count: int, width: int, *, repeats: int = TIMED, gradients: bool = False
) -> dict[str, Any]:
    """Milliseconds a picture: medians of the stages, and means of the kernels.

    Args:
        raster: The device.
        count: Number of `timing_splats`.
        width: Of `timing_view`, pixels.
        repeats: Number of pictures that are counted.
        gradients: Whether the kernels include those of gradients.
    """
    arrays, view = timing_splats(count), timing_view(width)
    settings = Settings(outputs=GRADIENTS) if gradients else Settings()
    draw = partial(picture_of, raster, arrays, view, settings)
    v = {"rgb": np.full((view.height, view.width, 3), 1e-3, np.float32)}
    grads = {n: np.zeros_like(a) for n, a in zip(PARAMETERS, arrays, strict=True)}
    raster.keep(arrays, settings)
    for _ in range(min(WARM, repeats)):
        draw()
    rows = []
    for _ in range(repeats):
        draw()
        rows.append(raster.stats())
    median = {name: float(np.median([row[name] for row in rows])) for name in rows[0]}
    raster.profile(True)
    for _ in range(repeats):
        draw()
        if gradients:
            raster.backward(arrays, view, settings, v, grads)
    kernels = {n: total / repeats for n, (total, calls) in raster.kernel_times().items() if calls}
    raster.profile(False)
    raster.release(arrays, settings)
    device = sum(median[name] for name in ("project_ms", "sort_ms", "bin_ms", "blend_ms"))
    return {
        "splats": count,
        "size": [view.width, view.height],
        "visible": median["visible"],
        "entries": median["entries"],
        "device_ms": device,
        "pictures_a_second_on_the_device": 1e3 / device if device else None,
        "download_ms": median["download_ms"],
        "whole_call_ms": median["total_ms"],
        "stages_ms": {n: v for n, v in median.items() if n.endswith("_ms")},
        "kernels_ms": kernels,
        "device_bytes": median["device_bytes"],
    }
