"""`gscore bench raster --device`: time of a graphics card."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...raster import header
from ...raster.gpu.choice import Chosen
from ...raster.gpu.gpu_raster import GpuRaster
from ...raster.request import Frustum, Settings
from ...scene import Cameras
from ...splats import PARAMETERS, Splats
from ...text_format import count_text, number, size_text

STAGES = ("project_ms", "sort_ms", "bin_ms", "blend_ms")


@dataclass(frozen=True, kw_only=True)
class DeviceBench:
    """Forward passes on a graphics card: means over views, each of the fastest of several."""

    device: str
    """Name and driver."""
    splats: int
    views: int
    width: int
    """Width of the first view, px."""
    height: int
    """Height of the first view, px."""
    visible: float
    entries_per_tile: float
    """Splats per tile of `header.TILE`."""
    device_ms: float
    """Time of all stages on the device; 0: it has no timer."""
    download_ms: float
    """Time of the copy of the picture to the CPU."""
    total_ms: float
    """Time of a call, without the copy of the splats to the device."""
    fps: float
    stages_ms: dict[str, float]
    device_bytes: int


def bench_device(
    splats: Splats, cameras: Cameras, views: Sequence[int], chosen: Chosen, *, repeats: int = 5
) -> DeviceBench:
    """Measure forward passes of `views` on a graphics card.

    Args:
        splats: The model.
        cameras: The capture's cameras.
        views: Indices into `cameras`.
        chosen: The graphics card.
        repeats: Passes per view; the fastest counts.

    Raises:
        BackendError: the device failed.
    """
    arrays = [np.ascontiguousarray(getattr(splats, name)) for name in PARAMETERS]
    settings, best, tiles = Settings(), [], 0
    with chosen.lend() as raster:
        assert isinstance(raster, GpuRaster)
        raster.keep(arrays, settings)
        for view in views:
            width, height = int(cameras.widths[view]), int(cameras.heights[view])
            tiles += -(-width // header.TILE) * -(-height // header.TILE)
            pictures = {
                "rgb": np.zeros((height, width, 3), np.float32),
                "alpha": np.zeros((height, width), np.float32),
            }
            frustum = Frustum(cameras.viewmats[view], cameras.Ks[view], width, height)
            passes = []
            for _ in range(repeats + 1):  # the first one warms up buffers
                raster.forward(arrays, frustum, settings, pictures)
                passes.append(raster.stats())
            best.append(min(passes[1:], key=lambda p: p["total_ms"]))
        raster.release(arrays, settings)
    n = len(best)
    mean = {key: sum(b[key] for b in best) / n for key in best[0]}
    stages = {key.removesuffix("_ms"): mean[key] for key in STAGES}
    return DeviceBench(
        device=chosen.identity,
        splats=len(splats),
        views=n,
        width=int(cameras.widths[views[0]]),
        height=int(cameras.heights[views[0]]),
        visible=mean["visible"],
        entries_per_tile=mean["entries"] * n / tiles,
        device_ms=sum(stages.values()),
        download_ms=mean["download_ms"],
        total_ms=mean["total_ms"],
        fps=1000 / mean["total_ms"],
        stages_ms=stages,
        device_bytes=int(max(b["device_bytes"] for b in best)),
    )


def device_table(r: DeviceBench) -> str:
    """The text of a measurement."""
    stages = "  ".join(f"{name} {ms:.2f}" for name, ms in r.stages_ms.items())
    return (
        f"{r.device}, {count_text(r.splats, 'splat')}, {count_text(r.views, 'view')} of "
        f"{r.width} x {r.height}\n"
        f"  {r.entries_per_tile:.0f} splats per tile, {number(round(r.visible))} visible, "
        f"{size_text(r.device_bytes)} of its memory\n"
        f"  forward {r.total_ms:.2f} ms ({r.fps:.0f} fps), {r.device_ms:.2f} ms on the device, "
        f"download {r.download_ms:.2f} ms; ms: {stages}\n"
    )
