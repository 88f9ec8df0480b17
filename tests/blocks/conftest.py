"""A street of houses, walked along: the use case of blocks."""

from pathlib import Path

import numpy as np
import pytest

from gscore.io.colmap.folder import write_model
from gscore.io.colmap.model import ColmapCamera, ColmapImage, ColmapModel, ColmapPoints
from gscore.io.images.png import write_png

LENGTH = 40.0
"""Length of the street, along +x; the houses are at z = 5, and down is +y."""
PHOTOS = 24


def street() -> ColmapModel:
    """Cameras that face the houses, and points on these with tracks."""
    rng = np.random.default_rng(3)
    xyz = np.column_stack(
        [rng.uniform(0, LENGTH, 2000), rng.uniform(-2, 2, 2000), rng.uniform(5, 6, 2000)]
    )
    ids = np.arange(10, 2010)
    camera = ColmapCamera(
        model="PINHOLE", width=40, height=30, params=np.array([40.0, 40.0, 20.0, 15.0])
    )
    images = []
    for i, x in enumerate(np.linspace(1, LENGTH - 1, PHOTOS)):
        local = xyz - [x, 0, 0]
        pixels = 40 * local[:, :2] / local[:, 2:] + [20, 15]
        shown = ((pixels >= 0) & (pixels < [40, 30])).all(axis=1)
        images.append(
            ColmapImage(
                id=i + 1,
                name=f"walk/{i:02}.png",
                camera_id=7,
                qvec=np.array([1.0, 0, 0, 0]),
                tvec=np.array([-x, 0.0, 0.0]),
                xys=pixels[shown],
                point3D_ids=ids[shown],
            )
        )
    points = ColmapPoints(
        ids=ids,
        xyz=xyz,
        rgb=rng.integers(1, 255, (2000, 3)).astype(np.uint8),
        error=np.full(2000, 0.5),
        track_lengths=np.full(2000, 3, np.int32),
    )
    return ColmapModel(cameras={7: camera}, images=images, points=points)


def write_street(folder: Path, model: ColmapModel) -> Path:
    """The street as a capture with photos and masks."""
    (folder / "sparse/0").mkdir(parents=True)
    write_model(model, folder / "sparse/0")
    for i, image in enumerate(model.images):
        for place in (f"images/{image.name}", f"masks/{image.name}.png"):
            (folder / place).parent.mkdir(parents=True, exist_ok=True)
        picture = np.full((30, 40, 3), 40 + 5 * i, np.uint8)
        write_png(folder / "images" / image.name, picture)
        mask = np.full((30, 40, 3), 255, np.uint8)
        mask[:5] = 0
        write_png(folder / "masks" / f"{image.name}.png", mask)
    return folder


@pytest.fixture(scope="session")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The street on disk."""
    return write_street(tmp_path_factory.mktemp("street") / "street", street())
