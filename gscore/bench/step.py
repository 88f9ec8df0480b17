"""Step bench: time of a training step and of its parts."""

import statistics
import time
from dataclasses import dataclass

from ..config import TrainConfig
from ..metrics.machine import peak_memory_bytes
from ..raster import native_library
from ..splats import Splats
from ..trainer.analysis.analysis import Analysis
from ..trainer.host.isolated_state import isolated_torch_state, mmap_large_blocks
from ..trainer.photos.view_sampler import Photos
from ..trainer.trainer import Trainer
from .raster import STAGES, BenchSetting

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
    laps_ms: dict[str, float]
    """Mean by part of the step."""
    raster_ms: dict[str, float]
    """Mean by stage of the rasterizer, within the parts of rendering and its gradients."""
    raster_share: float
    """Stages of the rasterizer / the whole step."""
    pairs_per_pixel: float
    peak_memory_bytes: int | None
    """Peak memory of the whole process so far; None: unknown."""


def bench_step(
    photos: Photos,
    splats: Splats,
    *,
    steps: int = 60,
    threads: int = 0,
    config: TrainConfig,
    photo_cache: int | None = None,
) -> StepBench:
    """Train for some steps from given splats, without densification.

    Args:
        photos: Training photos.
        splats: Initial splats, in COLMAP world.
        steps: Steps to measure.
        threads: 0: all cores.
        config: Method; its length, size and schedules are overridden here.
        photo_cache: Memory for decoded photos, bytes; others are decoded at each use. None: no
            limit.
    """
    total = steps + _WARM_UP
    given = {name: getattr(config, name) for name in ("strategy", "without", "ssim_weight")}
    config = TrainConfig(
        iterations=10_000 + total,
        max_splats=max(len(splats), 1),
        sh_degree=splats.sh_degree,
        refine_start=10_000 + total,
        coarse_factor=1.0,
        threads=threads,
        **given,
    )
    seconds: list[float] = []
    parts: dict[str, float] = {}
    stages = dict.fromkeys(STAGES, 0.0)
    pairs = pixels = 0.0
    mmap_large_blocks()
    with isolated_torch_state():
        trainer = Trainer(config, Analysis(photos=photos, start=splats, photo_cache=photo_cache))
        for step in range(total):
            began = time.perf_counter()
            trainer.step()
            took = time.perf_counter() - began
            if step < _WARM_UP:
                continue
            seconds.append(took)
            for name, value in trainer.stage_timer.seconds.items():
                parts[name] = parts.get(name, 0.0) + value
            for name in STAGES:
                stages[name] += trainer.stage_timer.raster[name]
            pairs += trainer.stage_timer.raster["forward_pairs"]
            pixels += trainer.stage_timer.pixels
    cameras = photos.scene.cameras
    raster = sum(stages.values()) / 1000
    return StepBench(
        isa=native_library.isa(),
        threads=threads or native_library.default_threads(),
        splats=len(splats),
        views=len(photos.train),
        width=int(cameras.widths[0]),
        height=int(cameras.heights[0]),
        steps=steps,
        step_ms=1000 * statistics.median(seconds),
        mean_ms=1000 * statistics.mean(seconds),
        laps_ms={name: 1000 * value / steps for name, value in parts.items()},
        raster_ms={name.removesuffix("_ms"): value / steps for name, value in stages.items()},
        raster_share=raster / sum(seconds),
        pairs_per_pixel=pairs / pixels,
        peak_memory_bytes=peak_memory_bytes(),
    )
