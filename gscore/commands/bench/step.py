"""`gscore bench step`: time of a training step and of its parts."""

import argparse
from functools import partial
from pathlib import Path

from ...bench.step import StepBench, bench_step
from ...bench.synthetic import SyntheticPhotos
from ...config import DataConfig, Skip, Strategy, TrainConfig
from ...datasets import load_dataset
from ...errors import ConfigError
from ...formats import read_splats
from ...text_format import count_text
from ..args.data_options import add_data_options, with_data_options
from ..parser import add_option, add_threads_option
from .shared import check_numbers, for_each_isa


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    option = partial(add_option, parser)
    option("source?", "capture of the splats in --ply; default: a synthetic one", Path)
    option("--ply PLY", "splat file trained on SOURCE; requires SOURCE", Path)
    option("--steps STEPS", "number of measured steps (60)", int, default=60)
    option("--splats SPLATS", "size of the synthetic cloud", int, default=100_000)
    option("--width WIDTH", "width of the synthetic views, px", int, default=640)
    option("--height HEIGHT", "height of the synthetic views, px", int, default=360)
    option("--strategy", choices=tuple(Strategy), default=Strategy.DEFAULT)
    skips = [skip.value for skip in Skip]
    option("--without SKIP...", choices=skips, default=())
    add_threads_option(parser)
    option(
        "--cache-mb MB",
        "memory for decoded photos of SOURCE; others are decoded at each use (all)",
        int,
    )
    option("--isa ISA", "instruction set; `all` measures each one available")
    add_data_options(parser)


def run(args: argparse.Namespace) -> int:
    """Measure and print."""
    if (args.source is None) != (args.ply is None):
        raise ConfigError("SOURCE and `--ply` belong together: give both, or neither.")
    if args.cache_mb is not None and (args.source is None or args.cache_mb < 1):
        raise ConfigError("`--cache-mb` is at least 1 and takes a SOURCE: synthetic photos stay.")
    check_numbers(args, 1, "steps", "splats", "width", "height")
    cache = None if args.cache_mb is None else args.cache_mb * 1_000_000
    if args.source is None:
        photos = SyntheticPhotos(args.splats, args.width, args.height)
        splats = photos.splats
    else:
        photos = load_dataset(with_data_options(DataConfig(source=args.source), args))
        if cache is None:
            photos.preload()
        else:
            photos.limit_cache()
        splats = read_splats(args.ply)
    config = TrainConfig(
        strategy=Strategy(args.strategy), without=tuple(Skip(name) for name in args.without)
    )
    for_each_isa(
        args,
        count_text(args.steps, "step"),
        lambda: bench_step(
            photos,
            splats,
            steps=args.steps,
            threads=args.threads,
            config=config,
            photo_cache=cache,
        ),
        _table,
    )
    return 0


def _table(r: StepBench) -> str:
    stages = "  ".join(f"{name} {ms:.2f}" for name, ms in r.laps_ms.items())
    raster = "  ".join(f"{name} {ms:.2f}" for name, ms in r.raster_ms.items())
    return (
        f"{r.isa}, {count_text(r.threads, 'thread')}, {count_text(r.splats, 'splat')}, "
        f"{count_text(r.views, 'view')}, "
        f"{r.width} x {r.height} px, {count_text(r.steps, 'step')}\n"
        f"  a step takes {r.step_ms:.2f} ms (median; mean {r.mean_ms:.2f}), "
        f"{100 * r.raster_share:.0f} % of it in the rasterizer; "
        f"{r.pairs_per_pixel:.1f} pairs per pixel\n"
        f"  ms by part: {stages}\n"
        f"  ms in the rasterizer: {raster}\n"
    )
