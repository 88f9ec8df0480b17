"""How far aligned depth maps are from the truth, fitted to their points alone and to each other.

python -m experiments.depth.alignment
python -m experiments.depth.alignment --views 24 50 --seeds 0 --width 480

Simulated network depth of the studio capture, as the experiment has it: mean relative error of the
aligned inverse depth over the pixels of the training views, at most 1 a pixel.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np

from gscore.config import DataConfig
from gscore.datasets import load_dataset
from gscore.datasets.decode import fit_map
from gscore.depth import fitting, load_priors

from .captures import exact, few_views, studio, write_mono

FAR = 0.6
"""Inverse depths below this share of the nearest tenth's are far."""


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--views", nargs="+", type=int, default=[6, 12, 24], help="to train on")
    parser.add_argument("--seeds", nargs="+", type=int, default=list(range(6)), help="of the maps")
    parser.add_argument("--width", type=int, default=160, help="of the photos in training, px")
    args = parser.parse_args()
    print("| views | fitted to | accepted | error | error of what is far |\n|---|---|---|---|---|")
    together = fitting.agreed
    with tempfile.TemporaryDirectory() as folder:
        for count in args.views:
            source, capture = studio(), Path(folder) / str(count)
            names = few_views(source, count, capture)
            for seed in args.seeds:
                write_mono(source, names, capture / f"depths-{seed}", seed=seed)
            for words, agreed in (
                ("their points", lambda fits, maps, cameras: fits),
                ("their points and each other", together),
            ):
                fitting.agreed = agreed
                found = np.mean([_errors(capture, seed, args.width) for seed in args.seeds], axis=0)
                print(f"| {count} | {words} | {found[0]:.0%} | {found[1]:.3f} | {found[2]:.3f} |")


def _errors(capture: Path, seed: int, width: int) -> tuple[float, float, float]:
    """Share of accepted maps, mean error of all pixels, and of far ones."""
    config = DataConfig(source=capture, resolution=width, depths=f"depths-{seed}", mask_mode="none")
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
