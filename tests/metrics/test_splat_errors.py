"""Errors per splat, against float64 pictures of one white splat after the other."""

from dataclasses import replace

import numpy as np
import pytest

from gscore.metrics.splat_errors import SplatErrors
from gscore.raster.api import render
from gscore.raster.request import Frustum
from gscore.report.colormap import brightest, colorize, error_map
from gscore.scene import Cameras
from gscore.sh import rgb_to_sh0, sh0_to_rgb
from gscore.splats import Splats


def some(count: int) -> Splats:
    """Around the origin."""
    rng = np.random.default_rng(0)
    return Splats(
        means=rng.standard_normal((count, 3), dtype=np.float32),
        quats=rng.standard_normal((count, 4), dtype=np.float32),
        scales=rng.standard_normal((count, 3), dtype=np.float32) * np.float32(0.4) - 2,
        opacities=rng.standard_normal(count, dtype=np.float32),
        sh0=rng.standard_normal((count, 1, 3), dtype=np.float32),
        shN=rng.standard_normal((count, 3, 3), dtype=np.float32) * np.float32(0.1),
    )


@pytest.fixture
def cameras() -> Cameras:
    """Two cameras that face the origin, 6 away."""
    viewmats = np.tile(np.eye(4), (2, 1, 1))
    viewmats[1, :3, :3] = np.roll(np.eye(3), 1, axis=1)
    viewmats[:, 2, 3] = 6
    K = np.array([[50.0, 0, 20], [0, 50.0, 18], [0, 0, 1]])
    return Cameras(
        viewmats=viewmats,
        Ks=np.tile(K, (2, 1, 1)),
        widths=np.array([40, 40]),
        heights=np.array([36, 36]),
        names=("a", "b"),
    )


def weights_of(splats: Splats, row: int, cameras: Cameras, index: int) -> np.ndarray:
    """[H, W] float64: the weight of a splat in each pixel, rendered in white among black ones."""
    colors = np.zeros((len(splats), 1, 3))
    colors[row] = 1
    lone = replace(splats, sh0=rgb_to_sh0(colors).astype(np.float32))
    size = int(cameras.widths[index]), int(cameras.heights[index])
    found = render(lone, cameras.Ks[index], cameras.viewmats[index], *size, sh_degree=0)
    return found.rgb[..., 0].astype(np.float64)


def test_mean_errors_of_the_pixels_of_each_splat(cameras: Cameras) -> None:
    """Oracle: weighted means, splat by splat, with pixels of zero or half weight."""
    splats, rng = some(40), np.random.default_rng(3)
    found = SplatErrors(splats)
    sums = np.zeros((len(splats), 2))
    for i in range(len(cameras)):
        size = int(cameras.widths[i]), int(cameras.heights[i])
        target, picture = rng.random((2, size[1], size[0], 3)) * [[[[0.9]]], [[[1.4]]]]
        mask = rng.choice([0, 128, 255], target.shape[:2]).astype(np.uint8) if i else None
        view = Frustum(cameras.viewmats[i], cameras.Ks[i], *size, 0.01)
        found.add(view, picture, target, mask)
        counts = np.ones(target.shape[:2]) if mask is None else mask / 255
        error = np.abs(np.minimum(picture, 1) - target).mean(axis=2)
        for row in range(len(splats)):
            weight = weights_of(splats, row, cameras, i) * counts
            sums[row] += (weight * error).sum(), weight.sum()
    seen = sums[:, 1] > 1.01
    assert seen.sum() > 10
    np.testing.assert_allclose(found.mean()[seen], (sums[:, 0] / sums[:, 1])[seen], rtol=1e-3)
    assert np.isnan(found.mean()[sums[:, 1] < 0.99]).all()


def test_invisible_splats_have_no_error(cameras: Cameras) -> None:
    """Oracle: splats far away from all cameras."""
    splats = some(5)
    found = SplatErrors(replace(splats, means=splats.means + np.float32(1000)))
    size = int(cameras.widths[0]), int(cameras.heights[0])
    black = np.zeros((size[1], size[0], 3))
    found.add(Frustum(cameras.viewmats[0], cameras.Ks[0], *size, 0.01), black, black + 1, None)
    assert np.isnan(found.mean()).all() and brightest(found.mean()) == 1.0


def test_the_map_has_their_colors() -> None:
    """Oracle: the colour map of error pictures; all other values of the splats are unchanged."""
    splats = some(4)
    errors = np.float32([0.0, 0.1, 0.4, np.nan])
    found = error_map(splats, errors, bright=0.2)
    rgb = sh0_to_rgb(found.sh0.astype(np.float64))[:, 0]
    wanted = colorize(np.array([0.0, 0.5, 1.0])) / 255.0
    np.testing.assert_allclose(rgb[:3], wanted, atol=1e-6)
    assert np.ptp(rgb[3]) < 1e-6 and found.sh_degree == 0
    for name in ("means", "quats", "scales", "opacities"):
        assert np.array_equal(getattr(found, name), getattr(splats, name))
    assert brightest(np.linspace(0, 1, 101)) == pytest.approx(0.95)
