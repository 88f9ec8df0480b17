"""Contributions of splats, against pictures of one white splat among black ones."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from gscore.edit import contributions
from gscore.raster.api import render
from gscore.scene import Cameras
from gscore.sh import rgb_to_sh0
from gscore.splats import Splats


def slowly(splats: Splats, cameras: Cameras, **options: bool) -> np.ndarray:
    """Weights by rendering each splat in white among black ones."""
    out = np.zeros((len(splats), len(cameras)))
    for row in range(len(splats)):
        colors = np.zeros((len(splats), 1, 3))
        colors[row] = 1
        lone = replace(splats, sh0=rgb_to_sh0(colors).astype(np.float32))
        for i in range(len(cameras)):
            size = int(cameras.widths[i]), int(cameras.heights[i])
            view = cameras.Ks[i], cameras.viewmats[i]
            rgb = render(lone, *view, *size, sh_degree=0, **options).rgb
            out[row, i] = rgb[..., 0].astype(np.float64).sum()
    return out.max(axis=1)


def test_equals_what_is_seen(make_splats: Callable[..., Splats], cameras: Cameras) -> None:
    """Oracle: white among black; with the compensation of antialiasing less than without."""
    splats = make_splats(80)
    wanted = slowly(splats, cameras)
    assert wanted.min() < 1 < 10 < wanted.max()
    found = contributions(splats, cameras)
    np.testing.assert_allclose(found, wanted, rtol=2e-4, atol=1e-3)
    compensated = contributions(splats, cameras, antialias=True)
    np.testing.assert_allclose(compensated, slowly(splats, cameras, antialias=True), 2e-4, 1e-3)
    assert compensated.sum() < found.sum()


def test_views_are_reported(make_splats: Callable[..., Splats], cameras: Cameras) -> None:
    """Oracle: the number of cameras; splats outside all views contribute zero."""
    splats = make_splats(10)
    hidden = replace(splats, means=splats.means + np.float32(1000))
    reported: list[int] = []
    assert not contributions(hidden, cameras, on_view=reported.append).any()
    assert reported == [1, 2, 3]
