"""Detection of mattes among the masks of a folder."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gscore.config import DataConfig
from gscore.datasets import load_dataset
from gscore.datasets.masks import are_mattes
from gscore.io.images.png import write_png
from gscore.io.images.read_image import read_mask

H, W = 60, 80


def _ellipse(x: float, y: float, rx: float, ry: float) -> np.ndarray:
    row, column = np.mgrid[:H, :W]
    return ((column - x) / rx) ** 2 + ((row - y) / ry) ** 2 <= 1


def _person(i: int) -> np.ndarray:
    """A person in the middle, her feet outside the picture."""
    return _ellipse(38 + i, 40, 12, 35)


def _passer_by(i: int) -> np.ndarray:
    return ~_ellipse(8 * i, 40, 8, 25)


def _sky(i: int) -> np.ndarray:
    return np.broadcast_to(np.arange(H)[:, None] > 34 + i, (H, W))


def _lens(i: int) -> np.ndarray:
    return _ellipse(40, 30, 29, 29)


def _tripod(i: int) -> np.ndarray:
    return ~_ellipse(40 + i, 60, 15, 20)


@pytest.mark.parametrize(
    ("shape", "mattes"),
    [(_person, True), (_passer_by, False), (_sky, False), (_lens, False), (_tripod, False)],
)
def test_mattes_are_distinguished_from_masks_that_hide(
    shape: Callable[[int], np.ndarray], mattes: bool, tmp_path: Path
) -> None:
    """Oracle: the intended kind of each shape; also where one photo in five is an exception."""
    files = [tmp_path / f"{i:02d}.png" for i in range(20)]
    for i, file in enumerate(files):
        kept = np.ones((H, W)) if i % 5 == 4 else shape(i % 4)
        write_png(file, np.asarray(kept * 255, np.uint8))
    assert are_mattes(len(files), lambda i: read_mask(files[i])) == mattes


def test_one_mask_is_classified_by_its_pixels(tmp_path: Path) -> None:
    """Oracle: as above; equality of all masks is no evidence for one."""
    write_png(tmp_path / "a.png", np.asarray(_person(0) * 255, np.uint8))
    assert are_mattes(1, lambda _: read_mask(tmp_path / "a.png"))


def test_the_example_s_masks_are_mattes() -> None:
    """Oracle: mattes; an option has precedence."""
    studio = Path(__file__).parents[2] / "examples" / "studio"
    assert load_dataset(DataConfig(source=studio)).mask_mode == "composite"
    assert load_dataset(DataConfig(source=studio, mask_mode="ignore")).mask_mode == "ignore"
