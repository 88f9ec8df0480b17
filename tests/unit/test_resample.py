"""Scaling down with numpy. Oracle: `images.resize`, which is Pillow, to the bit."""

import numpy as np
import pytest

from gscore import ShapeError
from gscore.frontend import downscale
from gscore.io.images.read_image import resize


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ((64, 48), (32, 24)),
        ((63, 45), (21, 15)),
        ((64, 48), (64, 48)),
        ((101, 77), (64, 48)),
        ((300, 200), (97, 31)),
        ((50, 40), (50, 17)),
        ((50, 40), (1, 1)),
        ((640, 360), (639, 360)),
    ],
)
def test_equals_pillow(old: tuple[int, int], new: tuple[int, int]) -> None:
    """Oracle: `images.resize` on noise and on a picture of extremes."""
    rng = np.random.default_rng(1)
    noise = rng.integers(0, 256, (old[1], old[0], 3), np.uint8)
    extremes = (rng.integers(0, 2, (old[1], old[0], 3)) * 255).astype(np.uint8)
    for image in (noise, extremes, np.ascontiguousarray(noise[..., 0])):
        np.testing.assert_array_equal(downscale(image, *new), resize(image, *new))


@pytest.mark.parametrize(
    ("image", "size"),
    [
        (np.zeros((4, 4, 3), np.uint8), (5, 4)),
        (np.zeros((4, 4, 3), np.uint8), (0, 4)),
        (np.zeros((4, 4, 4), np.uint8), (2, 2)),
        (np.zeros((4, 4, 3), np.float32), (2, 2)),
    ],
)
def test_refuses(image: np.ndarray, size: tuple[int, int]) -> None:
    """Oracle: the docstring."""
    with pytest.raises(ShapeError):
        downscale(image, *size)
