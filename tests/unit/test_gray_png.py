"""Grey PNGs; oracle: Pillow."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gscore.errors import ShapeError
from gscore.io.pictures.gray_png import gray_png
from gscore.io.pictures.images import read_mask


@pytest.mark.parametrize("shape", [(1, 1), (7, 5), (300, 201)])
def test_levels_come_back(tmp_path: Path, shape: tuple[int, int]) -> None:
    """Oracle: Pillow, and the reader of masks."""
    levels = np.random.default_rng(0).integers(0, 256, shape).astype(np.uint8)
    (tmp_path / "a.png").write_bytes(gray_png(levels))
    with Image.open(tmp_path / "a.png", formats=["PNG"]) as picture:
        picture.verify()
    with Image.open(tmp_path / "a.png", formats=["PNG"]) as picture:
        assert picture.mode == "L" and np.array_equal(np.asarray(picture), levels)
    if levels.size > 1:
        assert np.array_equal(read_mask(tmp_path / "a.png"), levels)


@pytest.mark.parametrize(
    "wrong", [np.zeros((2, 2, 3), np.uint8), np.zeros((2, 2)), np.zeros((0, 3), np.uint8)]
)
def test_what_is_no_grey_picture(wrong: np.ndarray) -> None:
    """Oracle: three axes, floats, no pixels."""
    with pytest.raises(ShapeError, match="grey picture"):
        gray_png(wrong)
