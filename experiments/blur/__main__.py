"""Copy of a capture with some photos blurred.

python -m experiments.blur CAPTURE OUT gauss|line|lines --pixels P [--every N --offset K]

Every eighth photo, which `gscore train --eval` holds out, stays sharp. `gauss` blurs by a Gaussian
of P px at 800 px of width, `line` by a line of a random direction, 0.6 P to 2 P long, `lines` by
one of an exponential length, P on average. docs/experiments/2026-11-blur.md has the figures.
"""

import argparse
import shutil
from pathlib import Path

import numpy as np
from PIL import Image
from scipy import ndimage

from gscore.io.images.read_image import read_image

_WIDTH = 800


def gaussian(image: np.ndarray, deviation: float) -> np.ndarray:
    """[H, W, 3] float, blurred by a Gaussian, px."""
    return ndimage.gaussian_filter(image, (deviation, deviation, 0), mode="nearest")


def along_line(image: np.ndarray, angle: float, length: float) -> np.ndarray:
    """[H, W, 3] float, the mean along a line, px, whose angle is from the x axis down."""
    places = np.linspace(-length / 2, length / 2, max(int(2 * length), 2))
    shifts = [(at * np.sin(angle), at * np.cos(angle), 0) for at in places]
    moved = (ndimage.shift(image, shift, order=1, mode="nearest") for shift in shifts)
    return sum(moved, start=np.zeros_like(image)) / len(places)


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("capture", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("kind", choices=["gauss", "line", "lines"])
    parser.add_argument("--pixels", type=float, required=True, metavar="P")
    parser.add_argument("--every", type=int, default=1, metavar="N")
    parser.add_argument("--offset", type=int, default=0, metavar="K")
    args = parser.parse_args()
    shutil.copytree(args.capture / "sparse", args.out / "sparse")
    (args.out / "images").mkdir()
    rng = np.random.default_rng(5)
    for i, path in enumerate(sorted((args.capture / "images").iterdir())):
        if i % 8 == 0 or i % args.every != args.offset:
            shutil.copyfile(path, args.out / "images" / path.name)
            continue
        image = read_image(path)[..., :3].astype(np.float32)
        size = args.pixels * image.shape[1] / _WIDTH
        if args.kind == "gauss":
            image = gaussian(image, size)
        else:
            angle = rng.uniform(0, np.pi)
            length = rng.exponential(size) if args.kind == "lines" else rng.uniform(0.6, 2) * size
            image = along_line(image, angle, length)
        photo = Image.fromarray(np.clip(image + 0.5, 0, 255).astype(np.uint8))
        photo.save(args.out / "images" / path.name, quality=95)


if __name__ == "__main__":
    main()
