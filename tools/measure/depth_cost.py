"""Depth cost: the time of depth supervision per training step.

python tools/measure/depth_cost.py SPLATS.ply

Two trainings of the studio capture start from the same splats, one with the exact depth, and take
steps alternately. Prints medians of their times and of the ratios.
"""

import argparse
import statistics
import time
from pathlib import Path

from gscore.config import DataConfig, Switch, TrainConfig
from gscore.datasets import load_dataset
from gscore.io.ply.splats import read_ply
from gscore.trainer.analysis.analysis import Analysis
from gscore.trainer.depth.setup import prepare_depth
from gscore.trainer.host.isolated_state import isolated_torch_state
from gscore.trainer.trainer import Trainer

STUDIO = Path(__file__).parents[2] / "examples" / "studio"
WARM_UP = 6
"""Pairs of steps that are not measured."""


def main() -> None:
    """Print two lines."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("splats", type=Path, help="PLY of a training on examples/studio")
    parser.add_argument("--pairs", type=int, default=50)
    parser.add_argument("--threads", type=int, default=0)
    args = parser.parse_args()
    splats = read_ply(args.splats)
    data = DataConfig(source=STUDIO, mask_mode="none", depths="depths")
    # Full size, no refinement, tiny learning rates: all steps do the same work.
    config = TrainConfig(
        iterations=100_000,
        max_splats=len(splats),
        coarse_factor=1.0,
        refine_start=100_000,
        lr_boost=1e-12,
        threads=args.threads,
        depth_mode=Switch.ON,
        depth_points=0,
    )
    photos = load_dataset(data)
    targets = prepare_depth(data, config, photos).loss_targets
    assert targets is not None
    with isolated_torch_state():
        plain = Trainer(config, Analysis(photos=photos, start=splats))
        deep = Trainer(config, Analysis(photos=photos, start=splats, depth=targets))
        times = [(_step(plain), _step(deep)) for _ in range(WARM_UP + args.pairs)][WARM_UP:]
    width, height = int(photos.scene.cameras.widths[0]), int(photos.scene.cameras.heights[0])
    print(f"{len(splats)} splats, {width} x {height} px, {args.pairs} pairs of steps")
    for i, unit in enumerate(("ms", "ms of CPU time")):
        without = statistics.median(pair[0][i] for pair in times)
        with_depth = statistics.median(pair[1][i] for pair in times)
        ratio = statistics.median(pair[1][i] / pair[0][i] for pair in times)
        print(f"without {without:.1f}, with {with_depth:.1f} {unit}: {ratio - 1:+.1%}")


def _step(trainer: Trainer) -> tuple[float, float]:
    """Wall and CPU milliseconds of a step."""
    wall, cpu = time.perf_counter(), time.process_time()
    trainer.step()
    return 1e3 * (time.perf_counter() - wall), 1e3 * (time.process_time() - cpu)


if __name__ == "__main__":
    main()
