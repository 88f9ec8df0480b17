"""Rank correlation of trust with the true error of held-out views.

python -m experiments.trust RUN ...

A run is one of `gscore train --eval`, whose held-out photos are the truth between its training
photos. Prints the trust of each and, for each run, the Spearman correlation of 1 - trust with the
mean squared error and with 1 - SSIM, and the time of the map of the run.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np

from gscore.commands.args.model_argument import ModelArgument, open_model
from gscore.datasets import Dataset, load_dataset
from gscore.metrics.photo_renders import PhotoRenders
from gscore.metrics.trust import trust, trust_between, trust_figures


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN")
    parser.add_argument("--psnr", default="psnr", help="key of the PSNR, psnr or psnr_cc")
    parser.add_argument("--threads", type=int, default=1)
    args = parser.parse_args()
    for run in args.runs:
        model = open_model(run)
        assert model.data is not None
        dataset = load_dataset(model.data)
        how = {"near": model.near, "antialias": model.antialias, "threads": args.threads}
        renders = PhotoRenders(model.splats, model.world_of(dataset.scene.cameras), **how)
        _correlate(run, renders, dataset, args.psnr)
        _time_map(model, renders, dataset)


def _correlate(run: Path, renders: PhotoRenders, dataset: Dataset, key: str) -> None:
    views = json.loads((run / "metrics.json").read_text())["views"]
    index = {name: i for i, name in enumerate(renders.cameras.names)}
    found = [trust(renders, dataset.train, renders.frustum(index[v["name"]], 64)) for v in views]
    psnr = np.array([view[key] for view in views])
    ssim = np.array([view["ssim"] for view in views])
    for view, worth, each in zip(views, psnr, found, strict=True):
        print(f"  {view['name']} {worth:.2f} dB, trust {each:.2f}")
    doubt = 1 - np.array(found)
    mse, dssim = spearman(doubt, 10 ** (-psnr / 10)), spearman(doubt, 1 - ssim)
    count = f"{len(dataset.train)} photos, {len(views)} views"
    print(f"{run}: {count}: {mse:.2f} by MSE, {dssim:.2f} by SSIM")


def _time_map(model: ModelArgument, renders: PhotoRenders, dataset: Dataset) -> None:
    started = time.process_time()
    figures = trust_figures(trust_between(renders, dataset.train))
    count, seconds = len(figures.get("trust", ())), time.process_time() - started
    print(f"  map: {count} views, {len(model.splats):,} splats, {seconds:.1f} s of a core")
    for each in sorted(figures.get("trust", ()), key=lambda each: each["trust"])[:5]:
        print(f"  lowest {each['trust']:.2f} between {' and '.join(each['between'])}")


def spearman(a: np.ndarray, b: np.ndarray) -> float:
    """Spearman's rank correlation, with mean ranks of equal values."""
    return float(np.corrcoef(_ranks(a), _ranks(b))[0, 1])


def _ranks(values: np.ndarray) -> np.ndarray:
    _, group, counts = np.unique(values, return_inverse=True, return_counts=True)
    return (np.cumsum(counts) - (counts + 1) / 2)[group]


if __name__ == "__main__":
    main()
