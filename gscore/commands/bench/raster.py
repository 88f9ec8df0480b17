"""`gscore bench raster`: time of the rasterizer alone."""

import argparse
from functools import partial
from pathlib import Path

import numpy as np

from ...bench.raster import RasterBench, bench_raster, synthetic_scene
from ...config import DataConfig
from ...datasets import load_dataset
from ...errors import ConfigError
from ...formats import read_splats
from ...text_format import count_text, number
from ..parser import add_option, add_threads_option
from .shared import check_numbers, for_each_isa


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
    option("--isa ISA", "instruction set; `all` measures each one available")


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    if (args.ply is None) != (args.cameras is None):
        raise ConfigError("`--ply` and `--cameras` belong together: give both, or neither.")
    check_numbers(args, 1, "views", "repeats", "splats", "width", "height")
    if args.ply is None:
        splats, cameras = synthetic_scene(args.splats, args.width, args.height)
    else:
        splats = read_splats(args.ply)
        data = DataConfig(source=args.cameras, resolution=args.resolution)
        cameras = load_dataset(data).scene.cameras
    count = min(args.views, len(cameras))
    views = np.unique(np.linspace(0, len(cameras) - 1, count).round().astype(int)).tolist()
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
