"""Do meshes help a training? With and without them, from few photos: a row a run.

python -m experiments.guide --out out/guide --captures plush --arms none scan --seeds 0 1

Captures but studio are those of GSCORE_DATA. Every eighth photo is held out, --views of the others
are trained on, with the points that two of them see. The scan is what a training on all photos but
the held-out ones shows, or studio's exact depth. What is there already is not trained again.
"""

import argparse
import json
import os
from pathlib import Path

import numpy as np

from experiments.depth.captures import Source, few_views, studio, train
from gscore.config import DataConfig
from gscore.datasets import load_dataset
from gscore.io.colmap.folder import read_model
from gscore.io.mesh.files import read_mesh
from gscore.io.ply.splats import read_ply
from gscore.raster.api import render
from gscore.raster.mesh import mesh_depth

from .meshes import scan_of, walls_of, write_scaled

ARMS = {
    "none": [],
    "scan": ["--guide-surface", "{scan}"],
    "scan-free": ["--guide-free", "{scan}"],
    "scan-both": ["--guide-surface", "{scan}", "--guide-free", "{scan}"],
    "large": ["--guide-surface", "{large}"],
    "small": ["--guide-surface", "{small}"],
    "walls": ["--guide-surface", "{walls}"],
}
"""What is trained with; large and small are the scan, 10 % off about the middle of the cameras."""
MESHES = ("scan", "large", "small", "walls")


def main() -> None:
    """Train what is not there yet and print a row a run."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("out/guide"))
    parser.add_argument("--captures", nargs="+", default=["plush", "stone_horse", "studio"])
    parser.add_argument("--arms", nargs="+", default=[*ARMS], choices=ARMS)
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1])
    parser.add_argument("--views", type=int, default=8)
    parser.add_argument("--name", default="", help="end of the names of these runs")
    parser.add_argument("--extra", nargs=argparse.REMAINDER, default=[], help="more options")
    args = parser.parse_args()
    for capture in args.captures:
        folder = _prepared(args.out, capture, args.views)
        for seed in args.seeds:
            for arm in args.arms:
                options = [p.format(**{n: folder / f"{n}.ply" for n in MESHES}) for p in ARMS[arm]]
                out = folder / f"{arm}{args.name}-{seed}"
                _train(folder, out, [*options, *args.extra], folder / "test.txt", seed)
                _tell(folder, out)


def _prepared(root: Path, capture: str, views: int) -> Path:
    """The folder of a capture of few photos with its meshes, made if they are not there."""
    source, folder = _source(capture), root / f"{capture}-{views}"
    if (folder / f"{MESHES[-1]}.ply").is_file():
        return folder
    few_views(source, views, folder)
    whole = None
    if capture != "studio":
        whole = root / f"{capture}-all"
        _train(source.folder, whole, [], folder / "test.txt", 0)
    model = read_model(source.folder)
    centers = np.stack([-i.viewmat[:3, :3].T @ i.viewmat[:3, 3] for i in model.images])
    scan = scan_of(source, whole and whole / "point_cloud.ply")
    for name, factor in (("scan", 1.0), ("large", 1.1), ("small", 0.9)):
        write_scaled(folder / f"{name}.ply", scan, factor, np.median(centers, axis=0))
    write_scaled(folder / "walls.ply", walls_of(scan, centers), 1.0, centers[0])
    return folder


def _train(source: Path, out: Path, options: list[str], test: Path, seed: int) -> None:
    if (out / "metrics.json").is_file():
        return
    line = ["--eval", "--preset", "preview", "--hold-out", str(test), "--seed", str(seed)]
    train(source, out, [*line, *options, "--mask-mode", "none", "--threads", "1"])


def _tell(folder: Path, out: Path) -> None:
    metrics = json.loads((out / "metrics.json").read_text())
    off, before, covered = _off_mesh(folder, out)
    print(
        f"{folder.name:14} {out.name:16} PSNR {metrics['psnr']:.2f}  SSIM {metrics['ssim']:.4f}  "
        f"depth error {off:.2%}, {before:.1%} before the scan, of {covered:.0%}",
        flush=True,
    )


def _source(capture: str) -> Source:
    if capture == "studio":
        return studio()
    folder = Path(os.environ["GSCORE_DATA"]) / "data" / capture
    names = sorted(image.name for image in read_model(folder).images)
    return Source(name=capture, folder=folder, depths=folder, unit=1.0, test=tuple(names[::8]))


def _off_mesh(folder: Path, out: Path) -> tuple[float, float, float]:
    """In held-out views, where the scan is: mean relative difference of the median depth to it, at
    most 1 a pixel; share of pixels that show something 5 % nearer; share of all pixels."""
    dataset = load_dataset(
        DataConfig(source=folder, test_list=folder / "test.txt", eval=True, resolution=400)
    )
    cameras, mesh = dataset.scene.cameras, read_mesh(folder / "scan.ply")
    splats = read_ply(out / "point_cloud.ply")
    ratios, covered = [], []
    for i in dataset.test:
        place = cameras.Ks[i], cameras.viewmats[i], int(cameras.widths[i]), int(cameras.heights[i])
        inverse = mesh_depth(mesh.vertices, mesh.triangles, *place)
        known = inverse > 0
        z = np.asarray(render(splats, *place).median_depth)
        ratios.append(z[known] * inverse[known])
        covered.append(known.mean())
    ratio = np.concatenate(ratios)
    before = (ratio > 0) & (ratio < 0.95)
    off = np.minimum(np.abs(ratio - 1), 1)
    return float(off.mean()), float(before.mean()), float(np.mean(covered))


if __name__ == "__main__":
    main()
