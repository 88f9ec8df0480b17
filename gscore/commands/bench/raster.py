"""`gscore bench raster`: time of the rasterizer alone."""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch

from ...bench.synthetic import synthetic_scene
from ...config import DataConfig
from ...datasets import load_dataset
from ...errors import ConfigError
from ...formats import read_splats
from ...raster import _native, header
from ...raster.memory import zeros
from ...raster.request import Frustum, Settings
from ...scene import Cameras
from ...splats import PARAMETERS, Splats
from ...text_format import count_text, number
from ..args.device_option import add_device_option, device_of
from ..parser import add_option, add_threads_option
from .device_raster import bench_device, device_table
from .shared import check_numbers, for_each_isa, measured

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


def bench_raster(
    splats: Splats,
    cameras: Cameras,
    views: Sequence[int],
    *,
    repeats: int = 5,
    threads: int = 0,
) -> RasterBench:
    """Measure forward and backward passes of `views`.

    Args:
        splats: The model.
        cameras: The capture's cameras.
        views: Indices into `cameras`.
        repeats: Passes per view; the fastest counts.
        threads: 0: all cores.
    """
    arrays = [torch.from_numpy(np.ascontiguousarray(getattr(splats, n))) for n in PARAMETERS]
    grads = {name: torch.zeros_like(a) for name, a in zip(PARAMETERS, arrays, strict=True)}
    rng = np.random.default_rng(0)  # of dense gradients of the picture
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
            settings = Settings(threads=threads)
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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of the verb."""
    option = partial(add_option, parser)
    option("--ply PLY", "splat file; default: a synthetic cloud", Path)
    option("--cameras CAMERAS", "capture of the training", Path)
    option("--views VIEWS", "number of views, evenly spaced (6)", int, default=6)
    option("--repeats REPEATS", "passes per view; the fastest counts", int, default=5)
    option("--splats SPLATS", "size of the synthetic cloud", int, default=100_000)
    option("--width WIDTH", "width of the synthetic view, px", int, default=640)
    option("--height HEIGHT", "height of the synthetic view, px", int, default=360)
    option(
        "-r, --resolution RESOLUTION", "size of the photos, as in `gscore train`", float, default=-1
    )
    add_threads_option(parser)
    add_device_option(parser, default="cpu")
    option("--isa ISA", "instruction set; `all` measures each one available")


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    if (args.ply is None) != (args.cameras is None):
        raise ConfigError("`--ply` and `--cameras` belong together: give both, or neither.")
    if args.isa and args.device != "cpu":
        raise ConfigError("`--isa` is for the CPU; leave it out with `--device`.")
    check_numbers(args, 1, "views", "repeats", "splats", "width", "height")
    if args.ply is None:
        splats, cameras = synthetic_scene(args.splats, args.width, args.height)
    else:
        splats = read_splats(args.ply)
        data = DataConfig(source=args.cameras, resolution=args.resolution)
        cameras = load_dataset(data).scene.cameras
    count = min(args.views, len(cameras))
    views = np.unique(np.linspace(0, len(cameras) - 1, count).round().astype(int)).tolist()
    device = device_of(args)
    if device.device is not None:
        measure = partial(bench_device, splats, cameras, views, device, repeats=args.repeats)
        measured(args, f"{device.name}, {count_text(len(splats), 'splat')}", measure, device_table)
        return 0
    for_each_isa(
        args,
        count_text(len(splats), "splat"),
        lambda: bench_raster(splats, cameras, views, repeats=args.repeats, threads=args.threads),
        _table,
    )
    return 0


def _table(r: RasterBench) -> str:
    stages = "  ".join(f"{name} {ms:.2f}" for name, ms in r.stages_ms.items())
    return (
        f"{r.isa}, {count_text(r.threads, 'thread')}, {count_text(r.splats, 'splat')}, "
        f"{count_text(r.views, 'view')} of {r.width} x {r.height}\n"
        f"  {r.gpairs_per_s:.2f} Gpair/s forward + backward blending "
        f"({r.gpairs_per_s_all_stages:.2f} with all stages), "
        f"forward {r.forward_gpairs_per_s:.2f}, backward {r.backward_gpairs_per_s:.2f}\n"
        f"  {r.pairs_per_pixel:.1f} pairs per pixel ({100 * r.useful_share:.0f} % useful), "
        f"{r.entries_per_tile:.0f} splats per tile, {number(round(r.visible))} visible\n"
        f"  forward {r.forward_ms:.2f} ms ({r.forward_fps:.0f} fps), "
        f"backward {r.backward_ms:.2f} ms; ms: {stages}\n"
    )
