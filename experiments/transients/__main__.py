"""Copy of a capture with an object pasted into some photos, each time elsewhere.

python -m experiments.transients CAPTURE OUT OBJECTS [--every N] [--size S] [--masks]

OBJECTS is a folder of pictures with opacity, such as the training photos of lego. Every eighth
photo, which `gscore train --eval` holds out, stays as it is; of the others every N-th shows the
object, S times as wide as the photo's longer side. `--masks` writes the true masks too.
docs/experiments/2026-11-transients.md has the figures.
"""

import argparse
import shutil
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps

from gscore.camera_neighbours import natural_key
from gscore.io.images.read_image import read_image

_OPAQUE = 3
"""Opacity of 255 from which a pixel shows the object."""


def objects_of(folder: Path) -> list[Image.Image]:
    """Every third picture of a folder, cut to its object."""
    paths = sorted(folder.glob("*.png"), key=lambda path: natural_key(path.name))
    pictures = [Image.open(path, formats=["PNG"]) for path in paths[::3]]
    return [one.crop(one.getchannel("A").getbbox()) for one in pictures]


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("capture", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("objects", type=Path)
    parser.add_argument("--every", type=int, default=3, metavar="N")
    parser.add_argument("--size", type=float, default=0.25, metavar="S")
    parser.add_argument("--masks", action="store_true")
    args = parser.parse_args()
    shutil.copytree(args.capture / "sparse", args.out / "sparse")
    (args.out / "images").mkdir()
    if args.masks:
        (args.out / "masks").mkdir()
    rng, objects = np.random.default_rng(7), objects_of(args.objects)
    for i, path in enumerate(sorted((args.capture / "images").iterdir())):
        which, x, y, mirrored = rng.integers(len(objects)), rng.random(), rng.random(), rng.random()
        photo = Image.fromarray(np.ascontiguousarray(read_image(path)[..., :3]))
        mask = Image.new("L", photo.size, 255)
        if i % 8 and i % args.every == 1 % args.every:
            shown = objects[which]
            width = int(args.size * max(photo.size))
            shown = shown.resize(
                (width, int(width * shown.height / shown.width)), Image.Resampling.LANCZOS
            )
            shown = ImageOps.mirror(shown) if mirrored < 0.5 else shown
            left = int(x * (photo.width - shown.width))
            top = int((0.25 + 0.75 * y) * (photo.height - shown.height))
            photo.paste(shown, (left, top), shown)
            hidden = Image.fromarray(np.asarray(shown.getchannel("A")) >= _OPAQUE)
            mask.paste(0, (left, top), hidden)
        photo.save(args.out / "images" / path.name, quality=95)
        if args.masks:
            mask.save(args.out / "masks" / f"{path.name}.png")


if __name__ == "__main__":
    main()
