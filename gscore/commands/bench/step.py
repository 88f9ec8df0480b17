"""`gscore bench step`: time of a training step and of its parts."""

import argparse
import statistics
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from ...bench.synthetic import SyntheticPhotos
from ...config import DataConfig, Skip, Strategy, TrainConfig
from ...datasets import load_dataset
from ...errors import ConfigError
from ...formats import read_splats
from ...metrics.machine import peak_memory_bytes
from ...raster import native_library
from ...splats import Splats
from ...text_format import count_text
from ...trainer.analysis.analysis import Analysis
from ...trainer.host.isolated_state import isolated_torch_state, mmap_large_blocks
from ...trainer.photos.view_sampler import Photos
from ...trainer.trainer import Trainer
from ..args.data_options import add_data_options, with_data_options
from ..args.device_option import add_device_option
from ..parser import add_option, add_threads_option
from .raster import STAGES, BenchSetting
from .shared import check_numbers, for_each_isa

_WARM_UP = 5
"""Steps that are not measured, because the first ones allocate memory."""


@dataclass(frozen=True, kw_only=True)
class StepBench(BenchSetting):
    """Steps of one training with a fixed number of splats; `views` are the training views."""

    steps: int
    """Steps measured."""
    step_ms: float
    """Median time of a step."""
    mean_ms: float
    """Mean time of a step, the sum of the parts below."""
    queued_ms: float
    """Mean time with steps in flight, as in trainings; 0: a training waits for each step."""
    laps_ms: dict[str, float]
    """Mean by part of the step."""
    raster_ms: dict[str, float]
    """Mean by stage of the rasterizer, within the parts of rendering and its gradients."""
    raster_share: float
    """Stages of the rasterizer / the whole step."""
    pairs_per_pixel: float
    peak_memory_bytes: int | None
    """Peak memory of the whole process so far; None: unknown."""


def _bench(
    args: argparse.Namespace, photos: Photos, splats: Splats, photo_cache: int | None
) -> StepBench:
    """Train for some steps from given splats, without densification.

    Args:
        args: Arguments of the command.
        photos: Training photos.
        splats: Initial splats, in COLMAP world.
        photo_cache: Memory for decoded photos, bytes; others are decoded at each use. None: no
            limit.
    """
    steps, threads = args.steps, args.threads
    total = 2 * steps + _WARM_UP
    config = TrainConfig(
        iterations=10_000 + total,
        max_splats=max(len(splats), 1),
        sh_degree=splats.sh_degree,
        refine_start=10_000 + total,
        coarse_factor=1.0,
        threads=threads,
        device=args.device,
        strategy=Strategy(args.strategy),
        without=tuple(Skip(name) for name in args.without),
    )
    seconds: list[float] = []
    parts: dict[str, float] = {}
    stages = dict.fromkeys(STAGES, 0.0)
    pairs = pixels = 0.0
    mmap_large_blocks()
    with isolated_torch_state():
        trainer = Trainer(config, Analysis(photos=photos, start=splats, photo_cache=photo_cache))
        for step in range(steps + _WARM_UP):
            began = time.perf_counter()
            trainer.step()
            took = time.perf_counter() - began
            if step < _WARM_UP:
                continue
            seconds.append(took)
            for name, value in trainer.stage_timer.seconds.items():
                parts[name] = parts.get(name, 0.0) + value
            for name in STAGES:
                stages[name] += trainer.stage_timer.raster.get(name, 0.0)  # the CPU's
            pairs += trainer.stage_timer.raster.get("forward_pairs", 0)
            pixels += trainer.stage_timer.pixels
        queued = _queued_seconds(trainer, steps) if trainer.engine.in_flight else 0.0
        identity = trainer.engine.info.numerics
        trainer.engine.close()
    cameras = photos.scene.cameras
    raster = sum(stages.values()) / 1000
    return StepBench(
        isa=identity,
        threads=threads or native_library.default_threads(),
        splats=len(splats),
        views=len(photos.train),
        width=int(cameras.widths[0]),
        height=int(cameras.heights[0]),
        steps=steps,
        step_ms=1000 * statistics.median(seconds),
        mean_ms=1000 * statistics.mean(seconds),
        queued_ms=1000 * queued / steps,
        laps_ms={name: 1000 * value / steps for name, value in parts.items()},
        raster_ms={name.removesuffix("_ms"): value / steps for name, value in stages.items()},
        raster_share=raster / sum(seconds),
        pairs_per_pixel=pairs / pixels,
        peak_memory_bytes=peak_memory_bytes(),
    )


def _queued_seconds(trainer: Trainer, steps: int) -> float:
    """Seconds of some steps of which a few are in flight at a time, until the last is done."""
    began = time.perf_counter()
    for _ in range(steps):
        trainer.advance()
    trainer.read_all()
    return time.perf_counter() - began


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
    add_device_option(parser, default="cpu")
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
    what = count_text(args.steps, "step")
    for_each_isa(args, what, lambda: _bench(args, photos, splats, cache), _table)
    return 0


def _table(r: StepBench) -> str:
    stages = "  ".join(f"{name} {ms:.2f}" for name, ms in r.laps_ms.items())
    raster = "  ".join(f"{name} {ms:.2f}" for name, ms in r.raster_ms.items())
    queued = (
        f"  {r.queued_ms:.2f} ms with others in flight, as in trainings\n" if r.queued_ms else ""
    )
    return (
        f"{r.isa}, {count_text(r.threads, 'thread')}, {count_text(r.splats, 'splat')}, "
        f"{count_text(r.views, 'view')}, "
        f"{r.width} x {r.height} px, {count_text(r.steps, 'step')}\n"
        f"  a step takes {r.step_ms:.2f} ms (median; mean {r.mean_ms:.2f}), "
        f"{100 * r.raster_share:.0f} % of it in the rasterizer; "
        f"{r.pairs_per_pixel:.1f} pairs per pixel\n{queued}"
        f"  ms by part: {stages}\n"
        f"  ms in the rasterizer: {raster}\n"
    )
