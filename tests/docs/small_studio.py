"""The bundled capture with every third view at an eighth of its size, for commands of the docs."""

import shutil
from dataclasses import replace
from pathlib import Path

from PIL import Image

from gscore.io.colmap.folder import read_model, write_model

ROOT = Path(__file__).parents[2]
STUDIO = ROOT / "examples" / "studio"
EVERY, FACTOR = 3, 8


def write_small_studio(folder: Path) -> None:
    """Photos, masks, depth maps and cameras under their own names."""
    model = read_model(STUDIO)
    images = sorted(model.images, key=lambda image: image.name)[::EVERY]
    for image in images:
        stem = Path(image.name).stem
        for name in (f"images/{image.name}", f"masks/{stem}.png", f"depths/{stem}.png"):
            _shrink(STUDIO / name, folder / name)
    cameras = {
        number: replace(
            camera,
            width=camera.width // FACTOR,
            height=camera.height // FACTOR,
            params=camera.params / FACTOR,
        )
        for number, camera in model.cameras.items()
    }
    assert {camera.model for camera in model.cameras.values()} <= {"PINHOLE", "SIMPLE_PINHOLE"}
    images = [replace(image, xys=image.xys / FACTOR) for image in images]
    write_model(replace(model, cameras=cameras, images=images), folder / "sparse/0")
    shutil.copy(STUDIO / "sparse/0/depth_params.json", folder / "sparse/0")


def write_small_video(folder: Path, capture: Path, frames: int) -> None:
    """A scenario in the layout of PKU-DyMVHumans in which nothing moves."""
    model = read_model(capture)
    for frame in range(frames):
        at = folder / f"data_COLMAP/{frame:06d}"
        (at / "images").mkdir(parents=True)
        images = []
        for number, image in enumerate(sorted(model.images, key=lambda image: image.name)):
            name = f"image_c_{number:03d}_f_{frame:06d}.jpg"
            shutil.copy(capture / "images" / image.name, at / "images" / name)
            images.append(replace(image, name=name))
        write_model(replace(model, images=images), at / "sparse")


def _shrink(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    with Image.open(source) as picture:
        size = picture.width // FACTOR, picture.height // FACTOR
        picture.resize(size, Image.Resampling.NEAREST).save(target)
