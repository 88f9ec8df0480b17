"""PNGs; oracle: Pillow."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gscore.errors import ShapeError
from gscore.io.images.png import png_bytes
from gscore.io.images.read_image import read_mask


@pytest.mark.parametrize("shape", [(1, 1), (7, 5), (300, 201)])
def test_levels_come_back(tmp_path: Path, shape: tuple[int, int]) -> None:
    """Oracle: Pillow, and the reader of masks."""
    levels = np.random.default_rng(0).integers(0, 256, shape).astype(np.uint8)
    (tmp_path / "a.png").write_bytes(png_bytes(levels))
    with Image.open(tmp_path / "a.png", formats=["PNG"]) as picture:
        picture.verify()
    with Image.open(tmp_path / "a.png", formats=["PNG"]) as picture:
        assert picture.mode == "L" and np.array_equal(np.asarray(picture), levels)
    if levels.size > 1:
        assert np.array_equal(read_mask(tmp_path / "a.png"), levels)


@pytest.mark.parametrize(
    "wrong", [np.zeros((2, 2, 2), np.uint8), np.zeros((2, 2)), np.zeros((0, 3), np.uint8)]
)
def test_invalid_pictures_are_refused(wrong: np.ndarray) -> None:
    """Oracle: two channels, floats, no pixels."""
    with pytest.raises(ShapeError, match="a PNG takes uint8"):
        png_bytes(wrong)


@pytest.mark.parametrize("packed", [True, False])
def test_colours_and_opacity(tmp_path: Path, packed: bool) -> None:
    """Oracle: Pillow's decoder; unchanged levels, also of transparent pixels."""
    pixels = np.random.default_rng(1).integers(0, 256, (7, 5, 4)).astype(np.uint8)
    pixels[:2, :, 3] = 0
    (tmp_path / "a.png").write_bytes(png_bytes(pixels, packed=packed))
    with Image.open(tmp_path / "a.png") as image:
        assert image.mode == "RGBA"
        assert np.array_equal(np.asarray(image), pixels)
    for wrong in (pixels[..., :2], pixels.astype(np.float32), pixels[:0]):
        with pytest.raises(ShapeError, match="uint8"):
            png_bytes(wrong)
