"""What gains leave: residuals of the training photos of a run by place and by brightness.

A vignette would be a residual that falls with the distance from the middle of the picture, another
response curve one that depends on the brightness. `python tools/measure/photo_residuals.py RUN
CAPTURE --width 400`
"""

import argparse
import itertools
from pathlib import Path

import numpy as np

import gscore
from gscore.config import DataConfig
from gscore.io.exposure_json import read_exposures
from gscore.photo_exposure import NEUTRAL, PhotoExposure

PHOTOS = 20
"""Most training photos, evenly spaced."""
DARKEST, BRIGHTEST = 0.06, 0.97
"""Values of pixels that count, of 1: others are clipped or mostly noise."""
OPAQUE = 0.98
"""Least alpha of pixels that count."""
RADII, VALUES = np.linspace(0, 1, 9), np.linspace(0, 1, 11)
"""Edges of the classes: distance from the middle in half diagonals, and mean value."""


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--width", default="auto", help="photo size, as `-r` of the training")
    args = parser.parse_args()
    resolution = args.width if args.width == "auto" else int(args.width)
    photos = gscore.load_dataset(DataConfig(source=args.capture, resolution=resolution))
    splats = gscore.read_splats(args.run / "point_cloud.ply")
    exposures = read_exposures(args.run)
    radii, values, residuals = [], [], []
    for view in photos.train[:: -(-len(photos.train) // PHOTOS)]:
        radius, value, residual = _residuals(photos, view, splats, exposures)
        radii.append(radius)
        values.append(value)
        residuals.append(residual)
    residual = np.concatenate(residuals)
    print(f"mean |ln photo - ln render|: {np.abs(residual).mean():.3f} of {residual.size:,} pixels")
    _print("distance from the middle", np.concatenate(radii), RADII, residual)
    _print("brightness", np.concatenate(values), VALUES, residual)


def _residuals(
    photos: gscore.Dataset,
    view: int,
    splats: gscore.Splats,
    exposures: dict[str, PhotoExposure],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return distance from the middle, mean value and residual of the pixels that count."""
    cameras, photo = photos.scene.cameras, photos.image(view) / 255.0
    height, width = photo.shape[:2]
    drawn = gscore.render(splats, cameras.Ks[view], cameras.viewmats[view], width, height)
    picture = exposures.get(photos.names[view], NEUTRAL).apply(np.asarray(drawn.rgb))
    counts = (photo.min(-1) > DARKEST) & (photo.max(-1) < BRIGHTEST)
    counts &= (picture.min(-1) > DARKEST / 2) & (np.asarray(drawn.alpha).squeeze() > OPAQUE)
    down, across = np.mgrid[:height, :width]
    middle = (width - 1) / 2, (height - 1) / 2
    radius = np.hypot(across - middle[0], down - middle[1]) / np.hypot(*middle)
    residual = (np.log(photo[counts]) - np.log(picture[counts])).mean(-1)
    return radius[counts], photo[counts].mean(-1), residual


def _print(name: str, of: np.ndarray, edges: np.ndarray, residual: np.ndarray) -> None:
    medians = []
    for first, last in itertools.pairwise(edges):
        chosen = residual[(of >= first) & (of < last)]
        medians.append(f"{100 * np.median(chosen):+.1f}" if chosen.size else "-")
    print(f"median in %, by {name}: {' '.join(medians)}")


if __name__ == "__main__":
    main()
