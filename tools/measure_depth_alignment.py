"""How far aligned depth maps are from the truth, fitted to their points alone and to each other.

python tools/measure_depth_alignment.py

Simulated network depth of the studio capture, as in experiment_depth.py: mean relative error of the
aligned inverse depth over the pixels of the training views, at most 1 a pixel.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from depth_captures import exact, few_views, write_mono
from experiment_depth import studio

from gscore.config import DataConfig
from gscore.datasets import load_dataset
from gscore.datasets.decode import fit_map
from gscore.depth import fitting, load_priors

COUNTS, SEEDS = (6, 12, 24), range(6)
FAR = 0.6
"""Inverse depths below this share of the nearest tenth's are far."""


def main() -> None:
    """Print a table."""
    print("| views | fitted to | accepted | error | error of what is far |\n|---|---|---|---|---|")
    together = fitting.agreed
    with tempfile.TemporaryDirectory() as folder:
        for count in COUNTS:
            source, capture = studio(), Path(folder) / str(count)
            names = few_views(source, count, capture)
            for seed in SEEDS:
                write_mono(source, names, capture / f"depths-{seed}", seed=seed)
            for words, agreed in (
                ("their points", lambda fits, maps, cameras: fits),
                ("their points and each other", together),
            ):
                fitting.agreed = agreed
                found = np.array([_errors(capture, seed) for seed in SEEDS]).mean(axis=0)
                print(f"| {count} | {words} | {found[0]:.0%} | {found[1]:.3f} | {found[2]:.3f} |")


def _errors(capture: Path, seed: int) -> tuple[float, float, float]:
    """Share of accepted maps, mean error of all pixels, and of far ones."""
    config = DataConfig(source=capture, resolution=160, depths=f"depths-{seed}", mask_mode="none")
    dataset = load_dataset(config)
    accepted, errors, far_errors = [], [], []
    for index, view in enumerate(load_priors(config, dataset).views):
        if view is None or view.fit is None:
            continue
        values = view.inverse_depth
        if not view.aligned:
            values = values * view.fit.scale + view.fit.offset
        truth = exact(studio(), dataset.names[index]).astype(np.float32)
        truth = fit_map(dataset.files[index], truth)
        off = np.minimum(np.abs(values / truth - 1), 1)
        far = truth < FAR * np.quantile(truth, 0.9)
        accepted.append(view.aligned)
        errors.append(float(off.mean()))
        far_errors.append(float(off[far].mean()))
    return float(np.mean(accepted)), float(np.mean(errors)), float(np.mean(far_errors))


if __name__ == "__main__":
    main()
