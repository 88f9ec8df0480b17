"""The order in which a tile's splats are blended; oracle: the sum written out."""

import numpy as np
import pytest

from gscore.raster.api import render
from gscore.splats import Splats

SIDE = 8


def _spread(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.uniform(1, 50, count)


def _tied(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.integers(2, 40, count).astype(np.float64)


def _clump_and_far_one(rng: np.random.Generator, count: int) -> np.ndarray:
    """So near each other that sixteen bits of the whole range do not separate them."""
    depths = 1 + 1e-4 * rng.permutation(count) / count
    depths[rng.integers(count)] = 1e6
    return depths


@pytest.mark.parametrize("depths_of", [_spread, _tied, _clump_and_far_one])
@pytest.mark.parametrize("count", [1, 2, 24, 25, 700, 70_000])
def test_splats_are_blended_by_depth_then_by_place(count: int, depths_of) -> None:  # type: ignore[no-untyped-def]
    """Oracle: wide splats of even alpha, one in front of the other, in float64, until a pixel is
    complete."""
    rng = np.random.default_rng(count)
    depths = depths_of(rng, count).astype(np.float32)
    opacities, colors = rng.uniform(0.005, 0.05, count), rng.uniform(0, 1, (count, 3))
    quats = np.zeros((count, 4), np.float32)
    quats[:, 0] = 1
    means = np.zeros((count, 3), np.float32)
    means[:, 2] = depths
    splats = Splats(
        means=means,
        quats=quats,
        scales=np.repeat(np.log(1e4 * depths)[:, None], 3, axis=1).astype(np.float32),
        opacities=np.log(opacities / (1 - opacities)).astype(np.float32),
        sh0=((colors - 0.5) / 0.28209479177387814)[:, None].astype(np.float32),
        shN=np.zeros((count, 0, 3), np.float32),
    )
    K = np.array([[20.0, 0, SIDE / 2], [0, 20.0, SIDE / 2], [0, 0, 1]])
    found = render(splats, K, np.eye(4), SIDE, SIDE, far=1e7).rgb

    order = np.argsort(depths, kind="stable")
    before = np.cumprod(np.concatenate([[1.0], 1 - opacities[order]]))
    weights = np.where(before[1:] > 1e-4, before[:-1] * opacities[order], 0)
    expected = weights @ colors[order]
    np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), atol=2e-5)
