"""Sequence comparison: trained sequences frame by frame, in moving and static regions.

python tools/measure/sequence.py out/warm out/scratch

Prints, for each output folder of `gscore sequence`, means over the frames after the first: PSNR of
the test views, of the median view, of moving and of still pixels, and flicker, the mean absolute
difference (of 255) of still pixels of a test view between consecutive frames.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_dilation

import gscore
from gscore import DataConfig, load_dataset
from gscore.config_file import load_config
from gscore.frontend import read_sequence

MOVES = 0.02 * 255
"""Difference between two frames above which a pixel counts as moving."""
MARGIN_PX = 3
COLUMNS = ("PSNR", "median view", "moving", "still", "flicker")


def main() -> int:
    """Print a row in Markdown for each sequence."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sequences", nargs="+", type=Path, help="outputs of `gscore sequence`")
    args = parser.parse_args()
    print(f"| sequence | {' | '.join(COLUMNS)} |\n|---|{'---|' * len(COLUMNS)}")
    for folder in args.sequences:
        values = measure(folder)
        print(f"| {folder.name} | {' | '.join(f'{v:.2f}' for v in values)} |", flush=True)
    return 0


def measure(folder: Path) -> np.ndarray:
    """[5] values of COLUMNS."""
    index = read_sequence(folder)
    if index is None:
        raise SystemExit(f"{folder} has no sequence.json; give an output of `gscore sequence`.")
    rows: list[list[float]] = []
    before: tuple[list[np.ndarray], list[np.ndarray]] | None = None
    for entry in index.frames:
        run = folder / entry["folder"]
        stored, _ = load_config(run / "config.json")
        photos, renders = pictures(stored, run / "point_cloud.ply")
        if before is not None:
            rows.append(compare(photos, renders, *before))
        before = photos, renders
    return np.mean(rows, axis=0)


def pictures(data: DataConfig, ply: Path) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Photos and renders of the test views, [H, W, 3] float 0 to 255 each."""
    dataset, splats = load_dataset(data), gscore.read_splats(ply)
    cameras = dataset.scene.cameras
    renders = []
    for i in dataset.test:
        size = int(cameras.widths[i]), int(cameras.heights[i])
        view = gscore.render(splats, cameras.Ks[i], cameras.viewmats[i], *size)
        renders.append(np.clip(view.rgb, 0, 1) * 255)
    return [dataset.image(i).astype(np.float32) for i in dataset.test], renders


def compare(
    photos: list[np.ndarray],
    renders: list[np.ndarray],
    old_photos: list[np.ndarray],
    old_renders: list[np.ndarray],
) -> list[float]:
    """Values of COLUMNS for a frame and the previous one."""
    whole, moving, still, flicker = [], [], [], []
    for photo, render, old, was in zip(photos, renders, old_photos, old_renders, strict=True):
        moves = binary_dilation(np.abs(photo - old).max(axis=2) > MOVES, iterations=MARGIN_PX)
        error = ((photo - render) ** 2).mean(axis=2)
        whole.append(psnr(error))
        moving.append(psnr(error[moves]))
        still.append(psnr(error[~moves]))
        flicker.append(float(np.abs(render - was)[~moves].mean()))
    return [float(v) for v in (np.mean(whole), np.median(whole), np.mean(moving))] + [
        float(np.mean(still)),
        float(np.mean(flicker)),
    ]


def psnr(error: np.ndarray) -> float:
    """PSNR of squared errors in units of 255, dB."""
    return float(-10 * np.log10(max(error.mean(), 1e-6) / 255**2))


if __name__ == "__main__":
    sys.exit(main())
