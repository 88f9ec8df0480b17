"""Step time by pixels and splats: the constants of trainer/estimate/cost.py.

    python tools/measure/captures.py && python tools/measure/step_time.py out/bench/*

Fits, to the speeds in the history of finished trainings,

    seconds = step + a_pixel * pixels + splats * (a_splat + a_number * numbers)

with non-negative coefficients and relative errors, and prints the resulting forecast of each
training. Also times the picture by which `gscore.engine.cpu.pace` compares machines. Run
everything on one idle machine.
"""

import argparse
import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import nnls

from gscore.config import TrainConfig
from gscore.config_file import from_dict
from gscore.engine.cpu import pace
from gscore.splats import SH_REST_BY_DEGREE
from gscore.trainer.estimate.cost import Cost
from gscore.trainer.schedule.plan import Plan

SKIPPED = 60
"""First steps, which are not used."""
WINDOW = 50
"""Number of steps averaged for a speed in the history."""


class Run(NamedTuple):
    """A finished training."""

    name: str
    plan: Plan
    seconds: float
    history: list[dict[str, Any]]

    @classmethod
    def read(cls, folder: Path) -> "Run":
        """Read the folder of a training that was not resumed."""
        names = ("metrics.json", "config.json", "cameras.json")
        metrics, config, cameras = (json.loads((folder / name).read_text()) for name in names)
        sizes = np.array([(camera["width"], camera["height"]) for camera in cameras])
        plan = Plan.of(
            from_dict(TrainConfig, config["train"], where=str(folder)),
            extent=1.0,
            points=metrics["history"][0]["splats"],
            side=int(sizes.min()),
            pixels=int(sizes.prod(axis=1).mean()),
        )
        return cls(folder.name, plan, metrics["train_seconds"], metrics["history"])

    def rows(self) -> list[list[float]]:
        """[seconds, pixels, splats, numbers] of a step, for each entry of the history."""
        found = []
        for entry in self.history:
            middle = entry["step"] - WINDOW // 2
            if entry["step"] >= SKIPPED and entry["steps_per_s"]:
                pixels = self.plan.pixels / self.plan.factor_at(middle) ** 2
                numbers = 11 + 3 * (1 + SH_REST_BY_DEGREE[self.plan.sh_degree_at(middle)])
                found.append([1 / entry["steps_per_s"], pixels, entry["splats"], numbers])
        return found


def main() -> None:
    """Read the runs, fit and print the constants."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path, help="folders of finished trainings")
    runs = [Run.read(folder) for folder in parser.parse_args().folders]
    print(f"_REFERENCE_MS = {pace.machine_pace() * pace._REFERENCE_MS:.2f}")
    seconds, pixels, count, numbers = np.array([row for run in runs for row in run.rows()]).T
    columns = np.stack([np.ones_like(pixels), pixels, count, count * numbers], axis=1)
    weights, _ = nnls(columns / seconds[:, None], np.ones_like(seconds))
    for name, value in zip(("step", "pixel", "splat", "number"), weights, strict=True):
        print(f"COST.{name} = {value:.3g}")
    ratio = columns @ weights / seconds
    low, middle, high = np.percentile(ratio, [5, 50, 95])
    print(f"predicted / measured: median {middle:.2f}, 5 to 95 %: {low:.2f} to {high:.2f}")
    print("With the current constants:")
    for run in runs:
        forecast_seconds = Cost(run.plan).seconds_after(0, run.history[0]["splats"])
        print(f"  {run.name}: forecast {forecast_seconds:.0f} s, measured {run.seconds:.0f} s")


if __name__ == "__main__":
    main()
