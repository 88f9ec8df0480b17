"""Models for the tests of formats."""

from collections.abc import Callable

import numpy as np
import pytest

import gscore
from gscore.splats import SH_REST_BY_DEGREE, Splats

MakeModel = Callable[..., Splats]
Draw = Callable[[Splats], np.ndarray]


@pytest.fixture
def make_model() -> MakeModel:
    """Models like trained ones: soft and hard splats of all shapes in front of a camera at the
    origin that faces +z."""

    def make(count: int = 3000, degree: int = 3, seed: int = 0) -> Splats:
        rng = np.random.default_rng(seed)

        def normal(*shape: int) -> np.ndarray:
            return rng.standard_normal(shape, dtype=np.float32)

        means = normal(count, 3) * np.float32(0.5)
        means[:, 2] += 3
        return Splats(
            means=means,
            quats=normal(count, 4),
            scales=normal(count, 3) * np.float32(0.5) - 3,
            opacities=normal(count) * 2,
            sh0=normal(count, 1, 3),
            shN=normal(count, SH_REST_BY_DEGREE[degree], 3) * np.float32(0.1),
        )

    return make


@pytest.fixture
def draw() -> Draw:
    """[96, 128, 3] picture of a model, values in [0, 1]."""
    K = np.array([[120.0, 0, 64], [0, 120, 48], [0, 0, 1]])

    def render(splats: Splats) -> np.ndarray:
        return np.clip(gscore.render(splats, K, np.eye(4), 128, 96, depths=False).rgb, 0, 1)

    return render
