"""Random splats and cameras that face them."""

from collections.abc import Callable

import numpy as np
import pytest

from gscore.scene import Cameras
from gscore.splats import Splats

SIZE = 40


@pytest.fixture
def make_splats() -> Callable[..., Splats]:
    """`count` splats around the origin with the given number of SH coefficients."""

    def make(count: int, rest: int = 3, *, seed: int = 0, spread: float = 1.0) -> Splats:
        rng = np.random.default_rng(seed)

        def normal(*shape: int) -> np.ndarray:
            return rng.standard_normal((count, *shape), dtype=np.float32)

        return Splats(
            means=normal(3) * np.float32(spread),
            quats=normal(4) * 2,
            scales=normal(3) * np.float32(0.4) - 2,
            opacities=normal(),
            sh0=normal(1, 3),
            shN=normal(rest, 3) * np.float32(0.1),
        )

    return make


@pytest.fixture
def cameras() -> Cameras:
    """Three cameras that face the origin along the axes, 6 away."""
    viewmats = np.tile(np.eye(4), (3, 1, 1))
    for i in range(3):
        viewmats[i, :3, :3] = np.roll(np.eye(3), i, axis=1)
        viewmats[i, 2, 3] = 6
    K = np.array([[50.0, 0, SIZE / 2], [0, 50.0, SIZE / 2], [0, 0, 1]])
    sizes = np.full(3, SIZE, np.int64)
    return Cameras(
        viewmats=viewmats,
        Ks=np.tile(K, (3, 1, 1)),
        widths=sizes,
        heights=sizes,
        names=("a", "b", "c"),
    )
