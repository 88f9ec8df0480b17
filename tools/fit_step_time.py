"""What a training step takes, by pixels and splats: the constants of gscore/trainer/schedules.py.

    GSCORE_DATA=... python tools/fit_step_time.py [--steps 400] [--captures plush,stone_horse]

Runs the beginning of trainings of several sizes, whose splats grow quickly, and fits

    seconds = step + a_pixel * pixels + splats * (a_splat + a_number * numbers)

with no negative part, errors counted relative. Also times the picture by which
`gscore.trainer.forecast` compares machines. Run it on a quiet machine.
"""

import argparse
import os
import time
from pathlib import Path

import numpy as np
from scipy.optimize import nnls

from gscore.config import DataConfig, TrainConfig
from gscore.datasets import load_dataset
from gscore.splats import SH_REST_BY_DEGREE
from gscore.trainer import forecast
from gscore.trainer.run import one_torch_thread
from gscore.trainer.trainer import Trainer

RUNS = ((400, 50_000, 1), (640, 150_000, 2), (1000, 100_000, 3))
"""Width, most splats and SH degree."""
SKIPPED = 10
"""First steps, which warm up."""


def rows(source: Path, width: int, splats: int, degree: int, steps: int) -> list[list[float]]:
    """[seconds, pixels, splats, numbers] of the steps of a short training."""
    photos = load_dataset(DataConfig(source=source, max_width=width, eval=True))
    photos.preload()
    config = TrainConfig(
        iterations=steps,
        max_splats=splats,
        sh_degree=degree,
        refine_start=steps // 8,
        refine_every=max(steps // 16, 1),
        grow_grad=1e-5,
    )
    trainer = Trainer(config, photos)
    found = []
    for step in range(1, steps + 1):
        count = len(trainer.model)
        began = time.perf_counter()
        trainer.step()
        seconds = time.perf_counter() - began
        pixels = trainer.plan.pixels / trainer.plan.factor_at(step) ** 2
        numbers = 11 + 3 * (1 + SH_REST_BY_DEGREE[trainer.plan.sh_degree_at(step)])
        if step > SKIPPED:
            found.append([seconds, pixels, count, numbers])
    return found


def main() -> None:
    """Measure, fit, print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--steps", type=int, default=400)
    parser.add_argument("--captures", default="plush,stone_horse")
    args = parser.parse_args()
    folder = Path(os.environ["GSCORE_DATA"]) / "data"
    found: list[list[float]] = []
    with one_torch_thread():
        forecast.machine_pace()
        forecast.machine_pace.cache_clear()
        print(f"_REFERENCE_MS = {forecast.machine_pace() * forecast._REFERENCE_MS:.2f}", flush=True)
        for name in args.captures.split(","):
            for width, splats, degree in RUNS:
                found += rows(folder / name, width, splats, degree, args.steps)
    seconds, pixels, count, numbers = np.array(found).T
    columns = np.stack([np.ones_like(pixels), pixels, count, count * numbers], axis=1)
    weights, _ = nnls(columns / seconds[:, None], np.ones_like(seconds))
    for name, value in zip(("STEP", "PIXEL", "SPLAT", "NUMBER"), weights, strict=True):
        print(f"_SECONDS_A_{name} = {value:.3g}")
    ratio = columns @ weights / seconds
    low, middle, high = np.percentile(ratio, [5, 50, 95])
    print(f"predicted / measured: median {middle:.2f}, 5 to 95 %: {low:.2f} to {high:.2f}")


if __name__ == "__main__":
    main()
