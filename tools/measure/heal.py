"""Healing of a hole, then training: a row of the table in docs/blender/editing.md.

python tools/measure/heal.py CAPTURE X Y Z -o FOLDER

Trains a preview at 300 px (once per FOLDER), removes the 5 % of its splats nearest to X Y Z, heals
the hole, and trains the box of that ball for 2,000 steps, with and without the healing. Prints
PSNR, dB, over the pixels of the held-out photos that the ball covers. The places of the table:

    plush 1.336 2.662 0.586         the body
    plush -0.726 2.898 1.23         the blanket
    stone_horse -0.851 -0.291 1.108 the neck
"""

import argparse
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from gscore import DataConfig, load_dataset, psnr, read_splats, render, write_splats
from gscore.datasets import Dataset
from gscore.edit.heal import heal
from gscore.formats.joined import joined
from gscore.io.region_file import write_region
from gscore.shared_constants import SH_C0
from gscore.splats import Splats

SIDE, SHARE, STEPS = 300, 0.05, 2000
"""Width of the photos, px; share of the splats in the ball; steps of the training in its box."""
COVERED, FEWEST = 0.5, 0.005
"""Least share of a pixel's colour that comes from the ball, and least share of such pixels in a
view that counts."""


def train(capture: Path, output: Path, *options: str) -> Splats:
    """The splats of a preview without exposure; with options trained even if they are there."""
    if options or not (output / "point_cloud.ply").exists():
        plain = ["--preset", "preview", "-r", str(SIDE), "--eval", "--exposure", "off"]
        command = [sys.executable, "-m", "gscore", "train", str(capture), "-o", str(output)]
        subprocess.run(
            [*command, *plain, *options, "--device", "cpu", "--quiet", "--overwrite"], check=True
        )
    return read_splats(output / "point_cloud.ply")


def picture(splats: Splats, photos: Dataset, view: int) -> np.ndarray:
    """[H, W, 3] float32, the splats over black."""
    cameras = photos.scene.cameras
    size = int(cameras.widths[view]), int(cameras.heights[view])
    K, viewmat = cameras.Ks[view], cameras.viewmats[view]
    return render(splats, K, viewmat, *size, depths=False, device="cpu").rgb


def covered(splats: Splats, inside: np.ndarray, photos: Dataset) -> dict[int, np.ndarray]:
    """[H, W] bool by held-out view: pixels whose colour mostly comes from the splats `inside`."""
    white = np.where(inside, 0.5 / SH_C0, -0.5 / SH_C0).astype(np.float32)
    flat = replace(splats, sh0=np.tile(white[:, None, None], (1, 1, 3)), shN=splats.shN[:, :0])
    masks = {view: picture(flat, photos, view)[..., 0] > COVERED for view in photos.test}
    return {view: mask for view, mask in masks.items() if mask.mean() > FEWEST}


def main() -> int:
    """Print the row."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("capture", type=Path)
    parser.add_argument("middle", type=float, nargs=3, metavar=("X", "Y", "Z"))
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the trainings")
    args = parser.parse_args()
    before = train(args.capture, args.output / "before")
    photos = load_dataset(DataConfig(source=args.capture, resolution=SIDE, eval=True))
    away = np.linalg.norm(before.means - args.middle, axis=1)
    radius = float(np.sort(away)[int(SHARE * len(before))])
    masks = covered(before, away <= radius, photos)
    ball = np.diag([radius, radius, radius, 1.0])
    ball[:3, 3] = args.middle
    erased = before.subset(away > radius)
    states = {"erased": erased, "healed": joined([erased, heal(erased, ball).splats])}
    write_region(args.output / "ball.json", ball)
    trained = {}
    for name, splats in states.items():
        start = args.output / f"{name}.ply"
        write_splats(start, splats)
        options = ["--start-splats", str(start), "--region", str(args.output / "ball.json")]
        options += ["--iterations", str(STEPS), "--max-splats", "100000"]
        trained[f"{name}, trained"] = train(args.capture, args.output / f"{name}-trained", *options)
    rows = {"before": before} | states | trained
    print(f"| {' | '.join(rows)} |\n|{'---|' * len(rows)}")
    means = []
    for splats in rows.values():
        pictures = {view: picture(splats, photos, view) for view in masks}
        means.append(
            np.mean(
                [psnr(pictures[v], photos.image(v) / np.float32(255), mask=masks[v]) for v in masks]
            )
        )
    print(f"| {' | '.join(f'{mean:.1f}' for mean in means)} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
