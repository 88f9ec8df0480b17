"""Rasterizer bench: time of the forward and the backward pass."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from ..raster import _native, header
from ..raster.memory import zeros
from ..raster.request import Frustum, Settings
from ..scene import Cameras
from ..splats import PARAMETERS, Splats

STAGES = (
    "project_ms",
    "sort_ms",
    "bin_ms",
    "blend_ms",
    "blend_backward_ms",
    "project_backward_ms",
)


@dataclass(frozen=True, kw_only=True)
class BenchSetting:
    """The library, the splats and the views of a measurement."""

    isa: str
    """Instruction set of the kernels."""
    threads: int
    splats: int
    views: int
    width: int
    """Width of the first view, px."""
    height: int
    """Height of the first view, px."""


@dataclass(frozen=True, kw_only=True)
class RasterBench(BenchSetting):
    """Means over views, each of the fastest of several passes."""

    gpairs_per_s: float
    """Pairs / (forward + backward blending time) / 1e9, a pair counted once."""
    gpairs_per_s_all_stages: float
    """The same over all stages of both passes: projection, sorting, binning, blending."""
    forward_gpairs_per_s: float
    """Blending alone."""
    backward_gpairs_per_s: float
    """Blending alone."""
    pairs_per_pixel: float
    """Splats evaluated at a pixel after culling and early termination."""
    useful_share: float
    """Share of these pairs that contribute to their pixel; the others fill blocks of 4 x 4."""
    entries_per_tile: float
    """Splats per tile of `header.LIST_TILE`."""
    visible: float
    forward_ms: float
    """Time of all stages of a forward pass."""
    backward_ms: float
    """Time of all stages of a backward pass."""
    forward_fps: float
    stages_ms: dict[str, float]
    workspace_bytes: int


def synthetic_scene(
    count: int = 100_000, width: int = 640, height: int = 360, seed: int = 0
) -> tuple[Splats, Cameras]:
    """A seeded cloud of small splats in front of one camera, for machines without a capture."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(2, 5, count)
    means = np.stack(
        [rng.uniform(-0.65, 0.65, count) * z, rng.uniform(-0.375, 0.375, count) * z, z], axis=1
    )
    splats = Splats(
        means=means.astype(np.float32),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        scales=(rng.normal(size=(count, 3)) * 0.7 + np.log(0.008)).astype(np.float32),
        opacities=(rng.normal(size=count) * 1.5 - 0.5).astype(np.float32),
        sh0=rng.normal(size=(count, 1, 3)).astype(np.float32),
        shN=(rng.normal(size=(count, 15, 3)) * 0.1).astype(np.float32),
    )
    focal = 500.0 * width / 640
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    cameras = Cameras(
        viewmats=np.eye(4)[None],
        Ks=K[None],
        widths=np.array([width]),
        heights=np.array([height]),
        names=("synthetic",),
    )
    return splats, cameras


def bench_raster(
    splats: Splats,
    cameras: Cameras,
    views: Sequence[int],
    *,
    repeats: int = 5,
    threads: int = 0,
    disable: int = 0,
    image_gradient_seed: int = 0,
) -> RasterBench:
    """Measure forward and backward passes of `views`.

    Args:
        splats: The model.
        cameras: The capture's cameras.
        views: Indices into `cameras`.
        repeats: Passes per view; the fastest counts.
        threads: 0: all cores.
        disable: Bits of `header.NO_*`.
        image_gradient_seed: Seed of the image gradients, which are dense and random.
    """
    arrays = [torch.from_numpy(np.ascontiguousarray(getattr(splats, n))) for n in PARAMETERS]
    grads = {name: torch.zeros_like(a) for name, a in zip(PARAMETERS, arrays, strict=True)}
    rng = np.random.default_rng(image_gradient_seed)
    best = []
    pixels = tiles = useful = 0
    with _native.pool.lend() as raster:
        for view in views:
            width, height = int(cameras.widths[view]), int(cameras.heights[view])
            pixels += width * height
            wide, high = header.LIST_TILE
            tiles += -(-width // wide) * -(-height // high)
            pictures = {"rgb": zeros(height, width, 3), "alpha": zeros(height, width)}
            v_rgb = torch.from_numpy(rng.normal(size=(height, width, 3)).astype(np.float32))
            frustum = Frustum(cameras.viewmats[view], cameras.Ks[view], width, height)
            settings = Settings(threads=threads, disable=disable)
            counting = replace(settings, outputs=header.COUNT_USEFUL)
            raster.forward(arrays, frustum, counting, pictures)
            useful += raster.stats()["useful_pairs"]
            passes = []
            for _ in range(repeats + 1):  # the first one warms up buffers
                raster.forward(arrays, frustum, settings, pictures)
                raster.backward(arrays, frustum, settings, {"rgb": v_rgb}, grads)
                passes.append(raster.stats())
            best.append(min(passes[1:], key=lambda p: sum(p[key] for key in STAGES)))
    total = {key: sum(b[key] for b in best) for key in best[0]}
    forward_ms = sum(total[key] for key in STAGES[:4])
    backward_ms = sum(total[key] for key in STAGES[4:])
    blending = total["blend_ms"] + total["blend_backward_ms"]
    n = len(best)
    return RasterBench(
        isa=_native.isa(),
        threads=threads or _native.default_threads(),
        splats=len(splats),
        views=n,
        width=int(cameras.widths[views[0]]),
        height=int(cameras.heights[views[0]]),
        gpairs_per_s=total["forward_pairs"] / blending / 1e6,
        gpairs_per_s_all_stages=total["forward_pairs"] / (forward_ms + backward_ms) / 1e6,
        forward_gpairs_per_s=total["forward_pairs"] / total["blend_ms"] / 1e6,
        backward_gpairs_per_s=total["backward_pairs"] / total["blend_backward_ms"] / 1e6,
        pairs_per_pixel=total["forward_pairs"] / pixels,
        useful_share=useful / total["forward_pairs"],
        entries_per_tile=total["entries"] / tiles,
        visible=total["visible"] / n,
        forward_ms=forward_ms / n,
        backward_ms=backward_ms / n,
        forward_fps=1000 * n / forward_ms,
        stages_ms={key.removesuffix("_ms"): total[key] / n for key in STAGES},
        workspace_bytes=int(max(b["workspace_bytes"] for b in best)),
    )
