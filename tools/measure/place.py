"""Compare a training of a made place with its truth: gains, and splats in front of the sky.

python examples/make_place.py yard -o out/yard --gains smooth
gscore train out/yard -o out/yard-run --preset draft --eval
python tools/measure/place.py out/yard-run out/yard
"""

import argparse
import json
from pathlib import Path

import numpy as np

import gscore
from gscore.config import DataConfig
from gscore.datasets import load_dataset
from gscore.io.exposure_json import read_exposures
from gscore.shared_constants import EXPOSURE_POWER


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("capture", type=Path)
    args = parser.parse_args()
    metrics = json.loads((args.run / "metrics.json").read_text())
    held_out = {view["name"] for view in metrics["views"]}
    truth = json.loads((args.capture / "truth.json").read_text())["stops"]
    exposures = read_exposures(args.run)
    stops = {n: EXPOSURE_POWER * np.log2(e.gain).mean() for n, e in exposures.items()}
    found = stops or dict.fromkeys(truth, 0.0)
    train = [name for name in truth if name not in held_out]
    shift = np.mean([found[name] - truth[name] for name in train])
    for title, names in (("training", train), ("held-out", sorted(held_out))):
        error = np.array([found[name] - truth[name] - shift for name in names])
        print(
            f"gains of {len(names)} {title} photos: error {np.abs(error).mean():.3f} stops", end=""
        )
        print(f" on average, {np.abs(error).max():.3f} at most")
    sky(args.run, args.capture)


def sky(run: Path, capture: Path) -> None:
    """Print errors of depths, and the share of the sky nearer than the farthest surface."""
    dataset = load_dataset(DataConfig(source=capture))
    splats = gscore.read_splats(run / "point_cloud.ply")
    pixels = near = 0
    errors = []
    depths = {p.name[: -len(".npy")]: np.load(p) for p in (capture / "depths").glob("*.npy")}
    cameras = dataset.scene.cameras
    for i, name in enumerate(cameras.names):
        true = depths[name]
        size = true.shape[1], true.shape[0]
        drawn = gscore.render(splats, cameras.Ks[i], cameras.viewmats[i], *size)
        median = np.asarray(drawn.median_depth)
        open_sky = ~np.isfinite(true)
        pixels += open_sky.sum()
        farthest = true[~open_sky].max(initial=0.0)
        near += (open_sky & (median > 0) & (median < farthest)).sum()
        errors.append(np.abs(median / true - 1)[~open_sky])
    print(f"depth of surfaces: median error {100 * np.median(np.concatenate(errors)):.2f} %")
    if pixels:
        share = f"{100 * near / pixels:.1f} % of {pixels:,} pixels"
        print(f"sky: {share} nearer than the farthest surface of the picture")


if __name__ == "__main__":
    main()
