"""How long a training step takes, and what its parts take."""

import hashlib
import statistics
import time
from dataclasses import dataclass

import numpy as np

from ..config import TrainConfig
from ..metrics.machine import peak_memory_bytes
from ..raster import backend
from ..raster.api import render
from ..scene import Cameras, PointCloud, Scene
from ..splats import Splats
from ..trainer.torch_threads import one_torch_thread
from ..trainer.trainer import Trainer
from ..trainer.views import Photos
from .raster import STAGES, synthetic_scene

_WARM_UP = 5
"""Steps that are not counted: the first ones allocate."""
_VIEWS = 6
"""Views of the synthetic scene."""


@dataclass(frozen=True, kw_only=True)
class StepBench:
    """Steps of one training at a fixed number of splats."""

    isa: str
    threads: int
    splats: int
    width: int
    """Of the first view, px."""
    height: int
    steps: int
    """Steps measured."""
    step_ms: float
    """Median time of a step."""
    mean_ms: float
    """Mean time of a step; the parts below add up to it."""
    laps_ms: dict[str, float]
    """Mean by part of the step."""
    raster_ms: dict[str, float]
    """Mean by stage of the rasterizer, within the laps of drawing and its gradients."""
    raster_share: float
    """Stages of the rasterizer / the whole step."""
    pairs_per_pixel: float
    peak_memory_bytes: int | None
    """Of the whole process so far."""


class SyntheticPhotos:
    """Pictures of a synthetic cloud from a few places, as a trainer takes them."""

    def __init__(self, count: int, width: int, height: int) -> None:
        self.splats, first = synthetic_scene(count, width, height)
        viewmats = np.repeat(first.viewmats, _VIEWS, axis=0)
        viewmats[:, 0, 3] = np.linspace(-0.1, 0.1, _VIEWS)
        cameras = Cameras(
            viewmats=viewmats,
            Ks=np.repeat(first.Ks, _VIEWS, axis=0),
            widths=np.repeat(first.widths, _VIEWS),
            heights=np.repeat(first.heights, _VIEWS),
            names=tuple(f"synthetic_{i}" for i in range(_VIEWS)),
        )
        points = PointCloud(
            points=self.splats.means.astype(np.float64), colors=np.zeros((count, 3), np.uint8)
        )
        self.scene = Scene(cameras=cameras, points=points)
        self.train = list(range(_VIEWS))
        self.test: list[int] = []
        self.mask_mode = "none"
        self._images = [self._photo(i, width, height) for i in self.train]

    def content_hash(self) -> str:
        """Of the pictures."""
        return hashlib.sha256(b"".join(i.tobytes() for i in self._images)).hexdigest()[:16]

    def image(self, index: int) -> np.ndarray:
        """[H, W, 3] uint8."""
        return self._images[index]

    def mask(self, index: int) -> None:
        """There is none."""

    def _photo(self, index: int, width: int, height: int) -> np.ndarray:
        cameras = self.scene.cameras
        rgb = render(
            self.splats, cameras.Ks[index], cameras.viewmats[index], width, height, depths=False
        ).rgb
        # Half as bright, so that the gradients are those of a picture that does not fit yet.
        return (np.clip(rgb, 0, 1) * 127 + 0.5).astype(np.uint8)


def bench_step(
    photos: Photos, splats: Splats, *, steps: int = 60, threads: int = 0, config: TrainConfig
) -> StepBench:
    """Train for some steps from given splats, without adding or removing any.

    Args:
        photos: What to train on.
        splats: Where to start, in COLMAP world.
        steps: Steps to measure.
        threads: 0: all cores.
        config: Method; its length, size and schedules are set here.
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
    laps: dict[str, float] = {}
    stages = dict.fromkeys(STAGES, 0.0)
    pairs = pixels = 0.0
    with one_torch_thread():
        trainer = Trainer(config, photos, start=splats)
        for step in range(total):
            began = time.perf_counter()
            trainer.step()
            took = time.perf_counter() - began
            if step < _WARM_UP:
                continue
            seconds.append(took)
            for name, value in trainer.laps.seconds.items():
                laps[name] = laps.get(name, 0.0) + value
            for name in STAGES:
                stages[name] += trainer.laps.raster[name]
            pairs += trainer.laps.raster["forward_pairs"]
            pixels += trainer.laps.pixels
    cameras = photos.scene.cameras
    raster = sum(stages.values()) / 1000
    return StepBench(
        isa=backend.isa(),
        threads=threads or backend.default_threads(),
        splats=len(splats),
        width=int(cameras.widths[0]),
        height=int(cameras.heights[0]),
        steps=steps,
        step_ms=1000 * statistics.median(seconds),
        mean_ms=1000 * statistics.mean(seconds),
        laps_ms={name: 1000 * value / steps for name, value in laps.items()},
        raster_ms={name.removesuffix("_ms"): value / steps for name, value in stages.items()},
        raster_share=raster / sum(seconds),
        pairs_per_pixel=pairs / pixels,
        peak_memory_bytes=peak_memory_bytes(),
    )
