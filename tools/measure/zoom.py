"""Zoom: held-out quality at higher and lower resolution than in the training.

    python tools/measure/zoom.py $GSCORE_DATA/data/plush --compare antialias=true finest=0.45

Trains each capture on photos of a quarter of their width, with the preset and with each change, and
measures the held-out views at 4 to 1/8 times that size. Prints the rows of the table in
docs/quality.md: PSNR, dB, and SSIM, means over the views.
"""

import argparse
import tempfile
from pathlib import Path

from gscore_line import verb

from gscore.config import DataConfig
from gscore.datasets.read import read_capture

SIZES = {"4": 4.0, "2": 2.0, "1": 1.0, "1/2": 1 / 2, "1/4": 1 / 4, "1/8": 1 / 8}
"""Sizes of the pictures, relative to those of the training."""


def row(capture: Path, width: int, preset: str, change: str) -> list[str]:
    """Cells of one training: PSNR and SSIM at each size."""
    with tempfile.TemporaryDirectory() as folder:
        options = [word for part in change.split(",") if part for word in ("--set", part)]
        verb("train", capture, "-o", folder, "--preset", preset, "-r", width, "--eval", *options)
        cells = []
        for size in SIZES.values():
            found = verb("eval", folder, "-r", round(size * width), "-o", f"{folder}/measured",
                         "--overwrite")  # fmt: skip
            cells.append(f"{found['psnr']:.2f}, {found['ssim']:.3f}")
    return cells


def main() -> None:
    """Train, measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("captures", type=Path, nargs="+")
    parser.add_argument("--preset", default="draft")
    parser.add_argument("--compare", nargs="*", default=[], metavar="NAME=VALUE[,...]")
    args = parser.parse_args()
    print(f"| capture | | {' | '.join(SIZES)} |\n{'|---' * (2 + len(SIZES))}|")
    for capture in args.captures:
        views = read_capture(DataConfig(source=capture)).views
        full = max(view.camera.width for view in views)
        for change in ("", *args.compare):
            cells = row(capture, full // 4, args.preset, change)
            print(f"| {capture.name} | {change or 'preset'} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
